// The finger as the camera sees it: its ray, refraction at the lower face, then the coating or
// a facet of a pyramid, shaded with the same irradiance() that fills the transport array.

#define NOTHING vec4(0.0)

uniform vec2 size;            // pixels
uniform vec2 half_view;       // the lens's image of half the columns and half the rows
uniform vec3 camera;          // world
uniform vec3 leftward, upward, ahead;  // in the camera's picture; ours is its mirror image
uniform float pivot;          // y at which the bent pad touches the plane of the flat one
uniform vec2 half_pad;        // half width and length of the pad
uniform float albedo;         // and what goes into the lobe
uniform sampler2D indirect;   // interreflected irradiance on the coating, over the pad
#ifdef FACES
uniform vec3 site_first;      // flat position of the first site
uniform vec2 site_step, site_count;
uniform float longest_shadow;  // mm from a pyramid's center
uniform sampler2D facet_indirect;  // (facet, site)
#endif
#ifdef HEIGHT_MAP
// What a slope adds to interreflected irradiance: weights of the normal's x, y, x x, x y, y y.
uniform sampler2D slope_indirect;
#endif
#ifdef CURVED
uniform sampler2D skin;        // normal into the pad and height over the pad, its border included
#ifdef FACES
uniform sampler2D site_frames;  // position, across, towards the tip, out of the pad; a row per site
#endif
const int STEPS = 32, HALVINGS = 16;

vec4 skin_at(vec2 place) {
    vec2 steps = vec2(textureSize(skin, 0));
    vec2 along = clamp(0.5 * place / half_pad + 0.5, 0.0, 1.0);
    return texture(skin, (along * (steps - 1.0) + 0.5) / steps);
}

// Way to the skin's height: the first step in which a ray crosses it; negative where it passes.
float way_to_skin(vec3 start, vec3 way) {
    vec2 ends = (sign(way.xy) * half_pad - start.xy) / way.xy;
    float last = min((thickness - start.z) / way.z, min(ends.x, ends.y));
    float before = 0.0, after = -1.0;
    for (int i = 1; i <= STEPS; ++i) {
        float here = last * float(i) / float(STEPS);
        vec3 place = start + here * way;
        if (place.z >= skin_at(place.xy).w - 1e-5) { after = here; break; }
        before = here;
    }
    if (after < 0.0) return -1.0;
    for (int i = 0; i < HALVINGS; ++i) {
        float middle = 0.5 * (before + after);
        vec3 place = start + middle * way;
        if (place.z >= skin_at(place.xy).w) after = middle; else before = middle;
    }
    return after;
}
#endif

out vec4 pixel;

// Way to the arc `bend * (y^2 + z^2) = 2 z` from its outside; negative where it is missed.
float way_to_arc(float bend, vec3 start, vec3 way) {
    float a = bend * dot(way.yz, way.yz);
    float half_b = bend * dot(start.yz, way.yz) - way.z;
    float c = bend * dot(start.yz, start.yz) - 2.0 * start.z;
    float discriminant = half_b * half_b - a * c;
    if (discriminant < 0.0 || half_b >= 0.0) return -1.0;
    return c / (sqrt(discriminant) - half_b);
}

#ifdef BENT
float curved = kappa;
#else
float curved = 0.0;
#endif

// World to flat position; `turn` receives cosine and sine of the local frame's rotation.
vec3 unbend(vec3 world, out vec2 turn) {
    float y = world.y - pivot, w = thickness - world.z;
    vec2 spoke = vec2(1.0 + curved * w, curved * y);
    float radius = length(spoke);
    turn = spoke / radius;
    float below = (curved * (y * y + w * w) + 2.0 * w) / (radius + 1.0);
#ifdef BENT
    y = atan(spoke.y, spoke.x) / kappa;
#endif
    return vec3(world.x, pivot + y, thickness - below);
}

vec3 to_local(vec3 d, vec2 turn) {
    return vec3(d.x, turn.x * d.y + turn.y * d.z, turn.x * d.z - turn.y * d.y);
}

void main() {
    vec2 image = 2.0 * gl_FragCoord.xy / size - 1.0;
    vec2 side = half_view * image;
#ifdef FISHEYE
    float angle = max(length(side), 1e-9);
    vec3 look = vec3(side * sin(angle) / angle, cos(angle));
#else
    vec3 look = vec3(side, 1.0);
#endif
    vec3 ray = normalize(look.x * leftward + look.y * upward + look.z * ahead);
    vec3 start = camera - vec3(0.0, pivot, 0.0);
    float bend = curved / (1.0 + curved * thickness);
    float way = way_to_arc(bend, start, ray);
    pixel = NOTHING;
    if (way < 0.0) return;
    vec3 entry = start + way * ray;
    vec3 normal = normalize(vec3(0.0, bend * entry.yz - vec2(0.0, 1.0)));
    float cos_in = -dot(ray, normal);
    vec3 inside = refract(ray, normal, 1.0 / refractive_index);
    float passed = 1.0 - reflectance(-dot(inside, normal));
#ifdef BONDED
    // The pad is flat: its window's lower face is z = 0, and the bond is parallel to it.
    vec3 across = vec3(ray.xy, 0.0);
    float squared = dot(across, across);
    vec2 rise = sqrt(vec2(window_index * window_index, refractive_index * refractive_index) - squared);
    passed = passes(ray.z, rise.x, 1.0, window_index)
        * passes(rise.x, rise.y, window_index, refractive_index);
    entry += vec3(across.xy / rise.x, 1.0) * bond;
    inside = vec3(across.xy, rise.y) / refractive_index;
#endif
#ifdef CURVED
    entry.y += pivot;
    if (any(greaterThan(abs(entry.xy), half_pad))) return;
    way = way_to_skin(entry, inside);
    if (way < 0.0) return;
    vec3 target = entry + way * inside;
    vec3 facing = normalize(skin_at(target.xy).xyz);
#else
    way = way_to_arc(curved, entry - vec3(0.0, 0.0, thickness), inside);
    if (way < 0.0) return;
    vec2 turn;
    vec3 target = unbend(entry + way * inside + vec3(0.0, pivot, 0.0), turn);
    if (any(greaterThan(abs(target.xy), half_pad))) return;
    target.z = thickness;
    vec3 facing = vec3(0.0, 0.0, -1.0);
#endif
    vec3 ambient = texture(indirect, 0.5 * target.xy / half_pad + 0.5).rgb;
#ifdef FACES
    vec2 number = clamp(round((target.xy - site_first.xy) / site_step), vec2(0.0), site_count - 1.0);
#ifdef CURVED
    int row = int(number.y * site_count.x + number.x);
    pyramid_frame = mat3(texelFetch(site_frames, ivec2(1, row), 0).xyz,
                         texelFetch(site_frames, ivec2(2, row), 0).xyz,
                         texelFetch(site_frames, ivec2(3, row), 0).xyz);
    vec3 from_site = (target - texelFetch(site_frames, ivec2(0, row), 0).xyz) * pyramid_frame;
    vec3 d = inside * pyramid_frame;
#else
    vec3 from_site = target - vec3(site_first.xy + number * site_step, thickness);
    vec3 d = to_local(inside, turn);
#endif
    // The pyramid is convex: the last plane entered is the facet seen, unless another is left first.
    float enter = -1e9, leave = 0.0;
    int facet = 0;
    for (int i = 0; i < FACES; ++i) {
        float speed = dot(facet_planes[i].xyz, d);
        float meets = (facet_planes[i].w - dot(facet_planes[i].xyz, from_site)) / speed;
        if (speed < 0.0) {
            if (meets > enter) { enter = meets; facet = i; }
        } else leave = min(leave, meets);
    }
    if (enter < leave) {
#ifdef CURVED
        facing = pyramid_frame * facet_planes[facet].xyz;
        target += enter * inside;
#else
        facing = facet_planes[facet].xyz;
        target += enter * d;
#endif
        int site = int(number.y * site_count.x + number.x);
        ambient = texelFetch(facet_indirect, ivec2(facet, site), 0).rgb;
    } else {
        from_pyramid = from_site;
        shadow_radius = longest_shadow;
    }
#endif
#ifdef HEIGHT_MAP
    // From where the ray is as deep as the deepest skin to where it meets the untouched one.
    float first = max(way - deepest / max(to_local(inside, turn).z, 0.05), 0.0), found = way;
    vec3 from = entry + vec3(0.0, pivot, 0.0);
    for (int k = 1; k <= MAX_STEPS; ++k) {
        float t = mix(first, way, float(k) / float(MAX_STEPS));
        vec3 place = unbend(from + t * inside, turn);
        if (pressed_at(place.xy) >= thickness - place.z) { found = t; break; }
    }
    float before = found - (way - first) / float(MAX_STEPS);
    for (int k = 0; k < 8; ++k) {
        float t = 0.5 * (before + found);
        vec3 place = unbend(from + t * inside, turn);
        if (pressed_at(place.xy) >= thickness - place.z) found = t;
        else before = t;
    }
    target.xy = unbend(from + found * inside, turn).xy;
    float depth = pressed_at(target.xy);
    target.z = thickness - depth;
    facing = skin_normal(target.xy, 1.0 + curved * depth);
    vec2 square = facing.xy * facing.xy;
    float terms[5] = float[5](facing.x, facing.y, square.x, facing.x * facing.y, square.y);
    for (int k = 0; k < 5; ++k)
        ambient += terms[k] * texelFetch(slope_indirect, ivec2(k, 0), 0).rgb;
    ambient = max(ambient, 0.0);
#endif
#ifdef LOBE
#ifdef CURVED
    sight = -inside;
#else
    sight = -to_local(inside, turn);
#endif
#endif
    vec3 light = irradiance(target, facing, 0, 0).here + ambient;
    float scale = albedo / 3.14159265 * passed / (refractive_index * refractive_index);
    pixel = vec4(scale * light, 1.0);
}
