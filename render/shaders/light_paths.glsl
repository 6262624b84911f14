// The two ways of light from a source inside the pad to a point inside the pad: straight, and once
// reflected by the lower face (z = 0). Positions are flat pad coordinates (x, y along the arc, z);
// directions are local: across, towards the tip, towards the coating. Bending enters through the
// curvature of the coating alone; see render/light_paths.py for the derivation.

uniform float thickness;
uniform float refractive_index;
#ifdef BENT
uniform float kappa;
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
    float s = (refractive_index * cos_in - cos_out) / (refractive_index * cos_in + cos_out);
    float p = (cos_in - refractive_index * cos_out) / (cos_in + refractive_index * cos_out);
    return squared > 0.0 ? 0.5 * (s * s + p * p) : 1.0;
}

// 1 / d^2, levelling off within SOFT_RADIUS, the cell of the glow that one point light stands for.
float inverse_square(float squared) {
    const float soft = SOFT_RADIUS * SOFT_RADIUS;
    return 1.0 / (squared + soft * soft / (squared + soft));
}

#ifdef BENT

Path direct_path(vec3 source, vec3 target) {
    float phi = kappa * (target.y - source.y);
    float chord = 2.0 * sin(0.5 * phi) / kappa, sine = sin(phi) / kappa;
    float sag = 0.5 * kappa * chord * chord;
    float below_source = 1.0 + kappa * (thickness - source.z);
    float below_target = 1.0 + kappa * (thickness - target.z);
    float across = target.x - source.x, rise = target.z - source.z;
    vec3 to_target = vec3(across, below_target * sine, rise + sag * below_target);
    vec3 to_source = vec3(-across, -below_source * sine, sag * below_source - rise);
    float squared = dot(to_target, to_target);
    float scale = inversesqrt(squared);
    // The coating hides what lies beyond its horizon; a raised point sees a lower horizon.
    float dip = sqrt(max(below_target * below_target - 1.0, 0.0));
    float clearance = dip * abs(to_source.y) - to_source.z;
    float cell = 2.0 * min(thickness - source.z, 0.25 * thickness);
    float visible = to_target.z <= 0.0 ? 1.0 : clamp(0.5 + clearance / cell, 0.0, 1.0);
    return Path(to_target * scale, to_source * scale, visible * inverse_square(squared));
}

Path mirrored_path(vec3 source, vec3 target) {
    float k = kappa / (1.0 + kappa * thickness);
    float way = sign(target.y - source.y);
    float arc = kappa * abs(target.y - source.y);
    float a = k * source.z, c = k * target.z;
    float p = 1.0 - a, q = 1.0 - c;
    float theta = arc * a / (a + c);
    vec2 s1, s2;
    // Newton's iteration for the arc at which both sides make the same angle with the face.
    for (int i = 0; i < 3; ++i) {
        s1 = vec2(sin(0.5 * theta), cos(0.5 * theta));
        s2 = vec2(sin(0.5 * (arc - theta)), cos(0.5 * (arc - theta)));
        vec2 w1 = vec2(2.0 * s1.x * s1.y, 1.0 - 2.0 * s1.x * s1.x);
        vec2 w2 = vec2(2.0 * s2.x * s2.y, 1.0 - 2.0 * s2.x * s2.x);
        float n1 = a + 2.0 * p * s1.x * s1.x, n2 = c + 2.0 * q * s2.x * s2.x;
        float f = p * w1.x * n2 - q * w2.x * n1;
        float slope = p * w1.y * n2 + q * w2.y * n1 - 2.0 * p * q * w1.x * w2.x;
        theta = clamp(theta - f / max(slope, 1e-3 * (a + c)), 0.0, arc);
    }
    s1 = vec2(sin(0.5 * theta), cos(0.5 * theta)) / k;
    s2 = vec2(sin(0.5 * (arc - theta)), cos(0.5 * (arc - theta))) / k;
    float n1 = source.z + 2.0 * p * k * s1.x * s1.x, n2 = target.z + 2.0 * q * k * s2.x * s2.x;
    float l1 = length(vec2(2.0 * p * k * s1.x * s1.y, n1));
    float l2 = length(vec2(2.0 * q * k * s2.x * s2.y, n2));
    float total = l1 + l2, across = target.x - source.x;
    float squared = total * total + across * across;
    float scale = inversesqrt(squared);
    float drop_source = source.z - 2.0 * k * s1.x * s1.x;
    float drop_target = target.z - 2.0 * k * s2.x * s2.x;
    vec3 depart = vec3(across * l1 / total, way * 2.0 * k * s1.x * s1.y, -drop_source);
    vec3 arrive = vec3(-across * l2 / total, -way * 2.0 * k * s2.x * s2.y, -drop_target);
    // The arc focuses in its own plane (Coddington); it never does so before the coating.
    float width = total - 2.0 * k * l1 * l2 * l1 / n1;
    float dip = 1.0 + kappa * (thickness - target.z);
    float clearance = sqrt(max(dip * dip - 1.0, 0.0)) * abs(arrive.y) + drop_target;
    float visible = clamp(10.0 * drop_source / source.z, 0.0, 1.0)
        * clamp(10.0 * clearance / target.z, 0.0, 1.0);
    float spread = total * inverse_square(squared) / max(width, 0.1 * total);
    float cosine = n1 / l1 * total * scale;
    return Path(normalize(depart), normalize(arrive), visible * spread * reflectance(cosine));
}

#else

Path direct_path(vec3 source, vec3 target) {
    vec3 way = target - source;
    float squared = dot(way, way);
    vec3 unit = way * inversesqrt(squared);
    return Path(unit, -unit, inverse_square(squared));
}

Path mirrored_path(vec3 source, vec3 target) {
    vec3 way = target - source;
    float height = source.z + target.z;
    float squared = dot(way.xy, way.xy) + height * height;
    float scale = inversesqrt(squared);
    vec3 depart = vec3(way.xy, -height) * scale;
    float spread = inverse_square(squared) * reflectance(height * scale);
    return Path(depart, vec3(-depart.xy, depart.z), spread);
}

#endif
