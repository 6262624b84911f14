// The two ways of light from a source inside the pad to a point inside the pad: straight, and once
// reflected by the lower face (z = 0). Positions are flat pad coordinates (x, y along the arc, z);
// directions are local: across, towards the tip, towards the coating. Bending enters through the
// curvature of the coating alone; see render/light_paths.py for the derivation.

uniform float thickness;
uniform float refractive_index;
#ifdef BENT
uniform float kappa;   // curvature of the coating, 1/mm
uniform float radius;  // 1 / kappa
#endif

#ifdef BONDED
uniform float bond, window_index;  // height of the upper face of a window; its index

// What passes a smooth face between two indices, by the momenta across it.
float passes(float before, float behind, float n_before, float n_behind) {
    float r = (before - behind) / (before + behind);
    vec2 p = vec2(n_behind * n_behind * before, n_before * n_before * behind);
    float s = (p.x - p.y) / (p.x + p.y);
    return 1.0 - 0.5 * (r * r + s * s);
}

#endif

struct Path {
    vec3 depart;   // unit direction at the source, away from it, in the source's local frame
    vec3 arrive;   // unit direction at the target, back along the path, in the target's frame
    float spread;  // irradiance on a surface facing the path per intensity at the source, 1/mm^2
};

// Reflectance of the lower face from inside; 1 beyond the critical angle.
float reflectance(float cos_in) {
    float squared = 1.0 - refractive_index * refractive_index * (1.0 - cos_in * cos_in);
    float cos_out = sqrt(max(squared, 0.0));
    vec2 inner = vec2(refractive_index, 1.0) * cos_in, outer = vec2(1.0, refractive_index) * cos_out;
    vec2 polarized = (inner - outer) / (inner + outer);
    return squared > 0.0 ? 0.5 * dot(polarized, polarized) : 1.0;
}

// 1 / d^2, levelling off within SOFT_RADIUS, the cell of the glow that one point light stands for.
float inverse_square(float squared) {
    const float soft = SOFT_RADIUS * SOFT_RADIUS;
    float near = squared + soft;
    return near / (squared * near + soft * soft);
}

#ifdef BENT

// (sine, cosine) after turning by an angle: series, within 1e-6 up to 0.9 rad (light that bends
// further round is hidden by the coating).
vec2 turned(vec2 unit, float angle) {
    float x = angle * angle;
    float sine = angle * (1.0 - x / 6.0 * (1.0 - x / 20.0 * (1.0 - x / 42.0)));
    float cosine = 1.0 - x / 2.0 * (1.0 - x / 12.0 * (1.0 - x / 30.0 * (1.0 - x / 56.0)));
    return vec2(unit.x * cosine + unit.y * sine, unit.y * cosine - unit.x * sine);
}

// Sine and cosine of half the angle between the frames of source and target.
vec2 half_turn(vec3 source, vec3 target) {
    return turned(vec2(0.0, 1.0), 0.5 * kappa * (target.y - source.y));
}

// 0 where the way would lead round by more than half a turn: the pad itself lies before it.
float before_half_turn(vec3 source, vec3 target) {
    return abs(kappa * (target.y - source.y)) < 3.14159265 ? 1.0 : 0.0;
}

// Tangent of the angle by which the coating's horizon lies below the local level at height z.
float horizon_dip(float z) {
    float below = kappa * (thickness - z);
    return sqrt(max(below * (2.0 + below), 0.0));
}

Path direct_path(vec3 source, vec3 target, vec2 turn) {
    vec2 arc = 2.0 * radius * turn.x * turn;  // sagitta of the coating, half its chord's run
    float below_source = 1.0 + kappa * (thickness - source.z);
    float below_target = 1.0 + kappa * (thickness - target.z);
    float across = target.x - source.x, rise = target.z - source.z;
    vec3 to_target = vec3(across, below_target * arc.y, rise + arc.x * below_target);
    vec3 to_source = vec3(-across, -below_source * arc.y, arc.x * below_source - rise);
    float squared = dot(to_target, to_target) + 1e-12;
    float scale = inversesqrt(squared);
    // The coating hides what sinks below its horizon; a raised point sees the horizon farther off.
    // The light stands for a cell of the glow, which sinks gradually.
    float dip = horizon_dip(target.z);
    float clearance = dip * abs(to_source.y) - to_source.z;
    float cell = 2.0 * min(thickness - source.z, 0.25 * thickness);
    bool nearer = abs(to_source.y) <= radius * dip && 2.0 * turn.x * turn.x < 1.0;
    float visible = nearer ? 1.0 : clamp(0.5 + clearance / cell, 0.0, 1.0);
    visible *= before_half_turn(source, target);
    return Path(to_target * scale, to_source * scale, visible * inverse_square(squared));
}

Path mirrored_path(vec3 source, vec3 target, vec2 turn) {
    float face_radius = radius + thickness, k = 1.0 / face_radius;
    float way = sign(target.y - source.y);
    float arc = kappa * abs(target.y - source.y);
    float a = k * source.z, c = k * target.z;
    float p = 1.0 - a, q = 1.0 - c;
    // Half the arcs from source and target to the point of reflection, from the flat mirror's.
    float theta = arc * source.z / (source.z + target.z);
    vec2 s1 = turned(vec2(0.0, 1.0), 0.5 * theta);
    vec2 s2 = vec2(abs(turn.x) * s1.y - turn.y * s1.x, turn.y * s1.y + abs(turn.x) * s1.x);
    // Newton's iteration for the arc at which both sides make the same angle with the face: three
    // steps leave 1e-6 of the arc.
    for (int i = 0; i < 3; ++i) {
        vec2 w1 = vec2(2.0 * s1.x * s1.y, 1.0 - 2.0 * s1.x * s1.x);
        vec2 w2 = vec2(2.0 * s2.x * s2.y, 1.0 - 2.0 * s2.x * s2.x);
        float n1 = a + 2.0 * p * s1.x * s1.x, n2 = c + 2.0 * q * s2.x * s2.x;
        float f = p * w1.x * n2 - q * w2.x * n1;
        float slope = p * w1.y * n2 + q * w2.y * n1 - 2.0 * p * q * w1.x * w2.x;
        float old = theta;
        theta = clamp(theta - f / max(slope, 1e-3 * (a + c)), 0.0, arc);
        s1 = turned(s1, 0.5 * (theta - old));
        s2 = turned(s2, 0.5 * (old - theta));
    }
    // Legs from source (1) and target (2) to the point of reflection, in mm: n along the normal
    // there, t along the tangents at their ends, l their lengths.
    vec2 r1 = 2.0 * face_radius * s1.x * s1, r2 = 2.0 * face_radius * s2.x * s2;
    float n1 = source.z + p * r1.x, n2 = target.z + q * r2.x;
    float l1 = sqrt(p * p * r1.y * r1.y + n1 * n1), l2 = sqrt(q * q * r2.y * r2.y + n2 * n2);
    float total = l1 + l2, across = (target.x - source.x) / total;
    float stretch = sqrt(1.0 + across * across);
    float drop_source = source.z - r1.x, drop_target = target.z - r2.x;
    vec3 depart = vec3(across * l1, way * r1.y, -drop_source) / (l1 * stretch);
    vec3 arrive = vec3(-across * l2, -way * r2.y, -drop_target) / (l2 * stretch);
    // The arc focuses in its own plane (Coddington); it never does so before the coating.
    float width = max(total - 2.0 * k * l1 * l2 * l1 / n1, 0.1 * total);
    float dip = horizon_dip(target.z);
    float visible = before_half_turn(source, target)
        * clamp(10.0 * drop_source / source.z, 0.0, 1.0)
        * clamp(10.0 * (dip * r2.y + drop_target) / target.z, 0.0, 1.0);
    float way_length = total * stretch;
    float spread = visible * total / width * inverse_square(way_length * way_length);
    return Path(depart, arrive, spread * reflectance(n1 / (l1 * stretch)));
}

#else

// The flat pad has one frame.
vec2 half_turn(vec3 source, vec3 target) { return vec2(0.0, 1.0); }

Path direct_path(vec3 source, vec3 target, vec2 turn) {
    vec3 way = target - source;
    float squared = dot(way, way) + 1e-12;
    vec3 unit = way * inversesqrt(squared);
    return Path(unit, -unit, inverse_square(squared));
}

Path mirrored_path(vec3 source, vec3 target, vec2 turn) {
    vec3 way = target - source;
    float height = source.z + target.z;
    float squared = dot(way.xy, way.xy) + height * height;
    float scale = inversesqrt(squared);
    vec3 depart = vec3(way.xy, -height) * scale;
    float spread = inverse_square(squared) * reflectance(height * scale);
    return Path(depart, vec3(-depart.xy, depart.z), spread);
}

#endif
