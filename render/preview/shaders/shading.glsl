// The shading function: direct irradiance at a point of the pad from a list of secondary lights,
// straight and by way of the lower face, per channel.

// (light, list): x, y, z in flat pad coordinates (mm); mark: the number of its face (left, tip,
// right, base, lower), and for a beam + 8 + 16 (m + 8) + 256 (n + 8) with the numbers of its
// reflections at walls along x and y, for a glow these too and + 4096 (i + 1) when it is the image
// of light i in such walls; -1 behind the last light of a list. With a window of another index
// (BONDED) positions are those in air, and + 4096 marks light that enters the window's edge. + 8192
// marks a beam that begins in the silicone (EMBEDDED).
uniform sampler2D lights;
uniform sampler2D emissions;  // (light * EMISSION_TEXELS + texel, list * CHANNELS + channel)
uniform int light_count;

#if CHANNELS == 3
#define Spectrum vec3
#else
#define Spectrum float
#endif

// A local direction in the frame of a face: along it, into the pad, upwards.
vec3 to_face(vec3 direction, int face) {
    if (face == 4) return direction.xzy;
    if (face == 3) return direction;
    if (face == 1) return vec3(direction.x, -direction.y, direction.z);
    return vec3(direction.y, face == 0 ? direction.x : -direction.x, direction.z);
}

#ifdef METAL
uniform float metal[4];  // reflectance of mirrors on left, tip, right and base; -1 without
#endif

// What is left of light that meets an edge `count` times in turn with the one that faces it.
float edges_reflect(int edge, int count, float cosine) {
    float once = reflectance(cosine), all = 1.0;
    for (int k = 0; k < count; ++k) {
#ifdef METAL
        float own = metal[(edge + 2 * k) & 3];
        all *= own < 0.0 ? once : own;
#else
        all *= once;
#endif
    }
    return all;
}

#ifdef CURVED

uniform sampler2D edge_height;  // of the skin, a row for left, tip, right and base
vec3 below = vec3(0.0, 0.0, -1.0);  // the skin's normal at the foot of a facet

// Whether an edge is there at a place: it ends where the skin meets it.
bool on_edge(int edge, vec3 place, vec3 low, vec3 high) {
    int axis = 1 - (edge & 1);
    float steps = float(textureSize(edge_height, 0).x);
    float along = clamp((place[axis] - low[axis]) / (high[axis] - low[axis]), 0.0, 1.0);
    vec2 texel = vec2((along * (steps - 1.0) + 0.5) / steps, (float(edge) + 0.5) / 4.0);
    return abs(place.z) < texture(edge_height, texel).r;
}

// Whether light from `source` to an unfolded `target` after reflections at edges meets them all;
// the target is below 0 where light comes by way of the lower face.
float meets_edges(vec3 source, vec3 target, ivec2 turns, vec3 low, vec3 high) {
    vec3 way = source - target, size = high - low;
    for (int axis = 0; axis < 2; ++axis) {
        for (int k = 0; k < abs(turns[axis]); ++k) {
            float plane = turns[axis] > 0 ? high[axis] + float(k) * size[axis]
                : low[axis] - float(k) * size[axis];
            vec3 place = target + way * ((plane - target[axis]) / way[axis]);
            vec2 turned = mod(place.xy - low.xy, 2.0 * size.xy);
            place.xy = low.xy + min(turned, 2.0 * size.xy - turned);
            int edge = (turns[axis] > 0 ? 2 - axis : 3 * axis) + 2 * k;
            if (!on_edge(edge & 3, place, low, high)) return 0.0;
        }
    }
    return 1.0;
}

#endif

#ifdef BONDED
Path clear_path(vec3 lamp, vec3 target, int face);
Path bonded_path(vec3 lamp, vec3 target, int face, bool by_window, bool mirrored);
#ifdef EMBEDDED
Path embedded_path(vec3 lamp, vec3 target, bool mirrored);
#endif
#endif

#ifdef BEAM

uniform float inverse_width;      // 1 / (2 sigma_v), rad^-1
uniform float optical_thickness[5];  // of the diffuser on each face, 0 without one
uniform vec3 box_low, box_high;   // of the silicone, diffuser included
uniform vec2 clear_half;          // half the clear pad

#ifdef PROFILES
uniform sampler2D profiles;  // measured profiles, a row each, over [0, pi/2]
uniform float profile_rows;
const float QUARTER_TURN = 1.5707963267948966;
#endif

// Intensity at an angle from the axis, relative to its peak.
float profile_shape(float theta, float cosine, vec4 own) {
#ifdef PROFILES
    if (cosine <= 0.0) return 0.0;
    if (own.x > 1.5) {
        float steps = float(textureSize(profiles, 0).x);
        float place = (theta / QUARTER_TURN * (steps - 1.0) + 0.5) / steps;
        return texture(profiles, vec2(place, (own.y + 0.5) / profile_rows)).r;
    }
    if (own.x > 0.5) return pow(cosine, own.y);
    return exp(-theta * theta * own.y * own.y) * cosine;
#else
    theta *= inverse_width;
    return exp(-theta * theta) * max(cosine, 0.0);
#endif
}

// A lamp in air is at `image` as one sees it from inside behind `face` along its normal. Returns
// where it seems to be from `target` by Snell's law, and in `factor` what that makes of the inverse
// square of the distance; 0 where the light would enter beside the face.
vec3 seen_through(vec3 image, vec3 target, int face, out float factor) {
    int axis = face == 4 ? 2 : (face == 0 || face == 2) ? 0 : 1;
    float way = face == 1 || face == 2 ? -1.0 : 1.0;
    float plane = way > 0.0 ? box_low[axis] : box_high[axis];
    float n = refractive_index;
    float outside = max(way * (plane - image[axis]), 1e-4) / n;
    float inside = way * (target[axis] - plane);
    vec3 across = target - image;
    across[axis] = 0.0;
    float reach = length(across);
    // Newton's method for the part of the way across that is inside, from the paraxial ray.
    float critical = inside * inversesqrt(max(n * n - 1.0, 1e-6));
    float lateral = min(reach * inside / (inside + n * outside), critical);
    for (int i = 0; i < 6; ++i) {
        float rest = reach - lateral;
        float near = inversesqrt(lateral * lateral + inside * inside);
        float far = inversesqrt(rest * rest + outside * outside);
        float slope = n * inside * inside * near * near * near
            + outside * outside * far * far * far;
        lateral = clamp(lateral - (n * lateral * near - rest * far) / slope, 0.0, reach);
    }
    float rest = reach - lateral;
    float cos_in = inside * inversesqrt(lateral * lateral + inside * inside);
    float cos_out = outside * inversesqrt(rest * rest + outside * outside);
    float seen = reach > 1e-3 * inside ? inside * rest / lateral : n * outside;
    float cubed = n * cos_in * cos_in * cos_in;
    float stretch = outside / (cos_out * cos_out) + inside * cos_out / cubed;
    vec3 entry = image + across * (rest / max(reach, 1e-6));
    entry[axis] = plane;
    vec3 low = box_low;
#ifdef BONDED
    low.z = bond;
#endif
    bool enters = inside > 0.0 && all(greaterThanEqual(entry, low))
        && all(lessThanEqual(entry, box_high));
    if (face == 4) enters = enters && all(lessThanEqual(abs(entry.xy), clear_half));
#ifdef CURVED
    else enters = enters && on_edge(face, entry, box_low, box_high);
#endif
    factor = enters ? cos_out * (inside + seen) / (cubed * stretch) : 0.0;
    image[axis] = plane - way * seen;
    return image;
}

#ifdef EMBEDDED

// A lamp in the silicone: its profile about its beam there. `own.z` is the optical depth of the
// diffuser that it is in, straight on into the pad.
float embedded_intensity(vec3 axis, float peak, vec4 own, vec3 d) {
    float towards = dot(d, axis);
    float angle = atan(length(cross(d, axis)), towards);
    float passed = own.z == 0.0 ? 1.0 : d.y <= 0.0 ? 0.0 : exp(-own.z / d.y);
    return peak * profile_shape(angle, towards, own) * passed;
}

#endif

// A lamp behind a smooth face: its profile about its beam in air, refracted into the pad, dimmed
// by the diffuser. `axis` is the beam, `peak` that of the intensity in air.
float beam_intensity(vec3 axis, float peak, vec4 own, vec3 d, int face) {
#ifdef BONDED
    // The direction is that in air, and the path knows what passes.
    float towards = dot(d, axis);
    float angle = atan(length(cross(d, axis)), towards);
    return peak * profile_shape(angle, towards, own);
#else
    vec2 side = refractive_index * d.xz;
    float squared = 1.0 - dot(side, side);
    if (d.y <= 0.0 || squared <= 0.0) return 0.0;
    vec3 air = vec3(side.x, sqrt(squared), side.y);
    float cosine = dot(air, axis);
    float theta = atan(length(cross(air, axis)), cosine);
    float solid_angle = refractive_index * refractive_index * d.y / air.y;
    float passed = 1.0 - reflectance(d.y);
    if (optical_thickness[face] > 0.0) passed *= exp(-optical_thickness[face] / d.y);
    return peak * profile_shape(theta, cosine, own) * passed * solid_angle;
#endif
}

#endif

#ifdef GLOW

// The glow of a diffuser: a polynomial radiance (render.preview.diffuser.basis) times the cosine.
float glow_intensity(vec4 low, vec4 high, float last, vec3 d) {
    float radiance = dot(low, vec4(1.0, d.x, d.z, d.x * d.x))
        + dot(high, vec4(d.x * d.z, d.z * d.z, d.y, d.y * d.x)) + last * d.y * d.z;
    return radiance * max(d.y, 0.0);
}

#endif

#ifdef BEAM

// What beam `i` of emission row `row` sends into two directions. Several channels share its shape
// and have their peaks in `intensities`.
vec2 beam_shape(int i, int row, int face, bool embedded, vec3 d, vec3 m) {
    ivec2 texel = ivec2(i * EMISSION_TEXELS, row);
    vec4 emission = texelFetch(emissions, texel, 0);
    float peak = CHANNELS == 1 ? emission.w : 1.0;
    vec4 own = vec4(0.0);
#ifdef PROFILES
    own = texelFetchOffset(emissions, texel, 0, ivec2(1, 0));
#endif
#ifdef EMBEDDED
    if (embedded) return vec2(embedded_intensity(emission.xyz, peak, own, d),
                              embedded_intensity(emission.xyz, peak, own, m));
#endif
    return vec2(beam_intensity(emission.xyz, peak, own, d, face),
                beam_intensity(emission.xyz, peak, own, m, face));
}

#endif

// What light `i` of emission row `row` sends into two directions; `shape` is a beam's.
vec2 intensities(int i, int row, bool beam, vec2 shape, vec3 d, vec3 m) {
    ivec2 texel = ivec2(i * EMISSION_TEXELS, row);
    vec4 low = texelFetch(emissions, texel, 0);
#ifdef BEAM
#ifdef GLOW
    if (beam)
#endif
        return CHANNELS == 1 ? shape : low.w * shape;
#endif
#ifdef GLOW
    vec4 high = texelFetchOffset(emissions, texel, 0, ivec2(1, 0));
    float last = texelFetchOffset(emissions, texel, 0, ivec2(2, 0)).x;
    return vec2(glow_intensity(low, high, last, d), glow_intensity(low, high, last, m));
#endif
}

#ifdef LOBE

uniform float lobe_share;      // of what the skin reflects
uniform float lobe_roughness;  // Beckmann alpha
vec3 sight;                    // unit direction to the camera, in the pad

// Smith's G1 for Beckmann roughness (Walter 2007, eq. 27).
float unmasked(float cosine) {
    float a = cosine / (lobe_roughness * sqrt(max(1.0 - cosine * cosine, 1e-12)));
    return a < 1.6 ? (3.535 * a + 2.181 * a * a) / (1.0 + 2.276 * a + 2.577 * a * a) : 1.0;
}

// How bright the skin is to the camera in light from a direction, 1 without a lobe: pi f over its
// reflectance (Walter 2007, eqs. 20 and 25).
float seen_brightness(vec3 arrive, vec3 normal) {
    float cos_in = dot(arrive, normal), cos_out = dot(sight, normal);
    if (cos_in <= 1e-4 || cos_out <= 1e-4) return 1.0 - lobe_share;
    float cosine = dot(normalize(arrive + sight), normal);
    float squared = cosine * cosine, alpha = lobe_roughness * lobe_roughness;
    float peak = exp((1.0 - 1.0 / squared) / alpha) / (alpha * squared * squared);
    float lobe = peak * unmasked(cos_in) * unmasked(cos_out) / (4.0 * cos_in * cos_out);
    return mix(1.0, lobe, lobe_share);
}

#endif

struct Light {
    Spectrum here;  // direct irradiance at the point
    Spectrum foot;  // and on the coating at the foot of its facet, unless the pyramid is before it
};

// Irradiance in 1/mm^2 per unit power at a flat pad position with a local unit normal. `first` is
// the row of `lights`, `list` the row (or group of rows) of `emissions`.
Light irradiance(vec3 position, vec3 normal, int first, int list) {
    Light sum = Light(Spectrum(0.0), Spectrum(0.0));
    for (int i = 0; i < light_count; ++i) {
        vec4 light = texelFetch(lights, ivec2(i, first), 0);
        if (light.w < 0.0) break;
        int mark = int(light.w), face = mark & 7;
        bool beam = (mark & 8) != 0, image = !beam && mark >= 4096;
        int sender = image ? mark / 4096 - 1 : i;
        ivec2 turns = beam || image ? (ivec2(mark >> 4, mark >> 8) & 15) - 8 : ivec2(0);
        vec2 flip = vec2(1 - 2 * (turns & 1));
        vec3 target = position, straight = light.xyz, folded = light.xyz;
        vec2 factor = vec2(1.0);
        bool embedded = false;
#ifdef EMBEDDED
        embedded = beam && (mark & 8192) != 0;
#endif
#ifdef BEAM
#ifdef GLOW
        if (beam)
#endif
        {
            // Seen in walls, the target is mirrored instead of the lamp.
            vec2 middle = 0.5 * (box_low + box_high).xy, step = (box_high - box_low).xy;
            target.xy = middle + flip * (target.xy - middle) + vec2(turns) * step;
#ifndef BONDED
#ifdef EMBEDDED
            if (!embedded) {
#endif
            straight = seen_through(light.xyz, target, face, factor.x);
            vec3 below = vec3(target.xy, -target.z);
            if (face == 4) factor.y = 0.0;
            else folded = seen_through(light.xyz, below, face, factor.y);
            if (factor.x + factor.y == 0.0) continue;
            // What cannot be reflected in the lower face has no mirrored way.
            folded.z = max(folded.z, 1e-3 * thickness);
#ifdef EMBEDDED
            }
#endif
#endif
        }
#endif
#ifdef BONDED
        bool by_window = mark >= 4096 || face == 4;
        Path direct, mirrored;
        if (by_window) direct = bonded_path(light.xyz, target, face, true, false);
        else direct = clear_path(light.xyz, target, face);
        if (face == 4) mirrored = Path(direct.depart, direct.arrive, 0.0);
        else mirrored = bonded_path(light.xyz, target, face, by_window, true);
#ifdef EMBEDDED
        if (embedded) {
            direct = embedded_path(light.xyz, target, false);
            mirrored = embedded_path(light.xyz, target, true);
        }
#endif
        vec2 spread = vec2(direct.spread, mirrored.spread);
        if (spread.x + spread.y == 0.0) continue;
#else
        Path direct = direct_path(straight, target, half_turn(straight, target));
        Path mirrored = mirrored_path(folded, target, half_turn(folded, target));
        vec2 spread = factor * vec2(direct.spread, mirrored.spread);
#endif
#ifdef CURVED
        spread *= vec2(
            meets_edges(straight, target, turns, box_low, box_high),
            meets_edges(folded, vec3(target.xy, -target.z), turns, box_low, box_high));
#endif
        for (int axis = 0; axis < 2; ++axis) {
            int count = abs(turns[axis]);
            if (count == 0) continue;
            // Towards +x and +y it is the right and the tip edge that the image lies beyond.
            int edge = turns[axis] > 0 ? 2 - axis : 3 * axis;
            vec2 cosine = image ? vec2(direct.depart[axis], mirrored.depart[axis])
                                : vec2(direct.arrive[axis], mirrored.arrive[axis]);
            spread *= vec2(edges_reflect(edge, count, abs(cosine.x)),
                           edges_reflect(edge, count, abs(cosine.y)));
        }
        if (image) {
            direct.depart.xy *= flip;
            mirrored.depart.xy *= flip;
        } else {
            direct.arrive.xy *= flip;
            mirrored.arrive.xy *= flip;
        }
        vec3 d = to_face(direct.depart, face), m = to_face(mirrored.depart, face);
        vec2 cosine = vec2(dot(direct.arrive, normal), dot(mirrored.arrive, normal));
        vec2 here = spread * max(cosine, 0.0);
#ifdef FACES
        if (length(from_pyramid.xy) < shadow_radius) {
#ifdef CURVED
            vec3 straight_way = direct.arrive * pyramid_frame;
            vec3 folded_way = mirrored.arrive * pyramid_frame;
#else
            vec3 straight_way = direct.arrive, folded_way = mirrored.arrive;
#endif
            if (here.x > 0.0) here.x *= past_pyramid(straight_way);
            if (here.y > 0.0) here.y *= past_pyramid(folded_way);
        }
#endif
#ifdef HEIGHT_MAP
        if (here.x > 0.0) here.x *= past_skin(position, direct.arrive);
        if (here.y > 0.0) here.y *= past_skin(position, mirrored.arrive);
#endif
#ifdef CURVED
        vec2 landing = vec2(dot(direct.arrive, below), dot(mirrored.arrive, below));
#else
        vec2 landing = -vec2(direct.arrive.z, mirrored.arrive.z);
#endif
        vec2 foot = step(0.0, cosine) * spread * max(landing, 0.0);
#ifdef LOBE
        here *= vec2(seen_brightness(direct.arrive, normal),
                     seen_brightness(mirrored.arrive, normal));
#ifdef CURVED
        vec3 ground = below;
#else
        const vec3 ground = vec3(0.0, 0.0, -1.0);
#endif
        foot *= vec2(seen_brightness(direct.arrive, ground),
                     seen_brightness(mirrored.arrive, ground));
#endif
        vec2 shape = vec2(0.0);
#ifdef BEAM
#ifdef GLOW
        if (beam)
#endif
            shape = beam_shape(sender, CHANNELS * list, face, embedded, d, m);
#endif
#if CHANNELS == 3
        for (int c = 0; c < 3; ++c) {
            vec2 sent = intensities(sender, 3 * list + c, beam, shape, d, m);
            sum.here[c] += dot(here, sent);
            sum.foot[c] += dot(foot, sent);
        }
#else
        vec2 sent = intensities(sender, list, beam, shape, d, m);
        sum.here += dot(here, sent);
        sum.foot += dot(foot, sent);
#endif
    }
    return sum;
}
