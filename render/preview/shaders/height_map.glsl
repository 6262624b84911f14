// Skin that is pressed in, as a map of depths over the pad (render.geometry.height_map).

uniform sampler2D height_map;  // mm, from the base and -x; the first and last texels on the edges
uniform vec2 map_half;         // half the pad's width and length
uniform vec2 map_step;         // distance of its columns and rows, mm
uniform vec4 map_bounds;       // low x and y, high x and y of what is pressed in
uniform float deepest;         // mm
uniform float longest_shadow;  // mm

float pressed_at(vec2 place) {
    vec2 count = vec2(textureSize(height_map, 0));
    vec2 at = (0.5 * place / map_half + 0.5) * (count - 1.0) + 0.5;
    return texture(height_map, at / count).r;
}

// Height of the untouched skin.
float level_at(vec2 place) {
#ifdef CURVED
    return skin_at(place).w;
#else
    return thickness;
#endif
}

// Unit normal of the skin into the pad; `along` is by how much the bend has stretched y there.
vec3 skin_normal(vec2 place, float along) {
    vec2 step_x = vec2(map_step.x, 0.0), step_y = vec2(0.0, map_step.y);
    vec2 slope = vec2(pressed_at(place + step_x) - pressed_at(place - step_x),
                      pressed_at(place + step_y) - pressed_at(place - step_y)) / (2.0 * map_step);
#ifdef CURVED
    vec3 untouched = skin_at(place).xyz;
    slope += untouched.xy / untouched.z;
#endif
    return normalize(vec3(-slope.x, -slope.y / along, -1.0));
}

const int MAX_STEPS = 64;

// 0 where the skin is before a light in the direction `arrive` from a point of it, 1 where not. The
// point's frame is taken for all of the way, as shadows are short against the radius of the bend.
float past_skin(vec3 from, vec3 arrive) {
    vec2 way = arrive.xy, safe = mix(way, vec2(1e-9), lessThan(abs(way), vec2(1e-9)));
    vec2 low = (map_bounds.xy - from.xy) / safe, high = (map_bounds.zw - from.xy) / safe;
    vec2 enters = min(low, high), leaves = max(low, high);
    float first = max(max(enters.x, enters.y), 0.0);
    float last = min(min(leaves.x, leaves.y), longest_shadow);
#ifndef CURVED
    if (arrive.z < -1e-6) last = min(last, (deepest + from.z - thickness) / -arrive.z);
#endif
    float grain = max(map_step.x, map_step.y);
    first = max(first, 1.5 * grain);
    float steps = min(ceil((last - first) / grain), float(MAX_STEPS));
    for (float k = 0.5; k < steps; k += 1.0) {
        float t = mix(first, last, k / steps);
        vec3 place = from + t * arrive;
        if (pressed_at(place.xy) > level_at(place.xy) - place.z + 0.05 * grain) return 0.0;
    }
    return 1.0;
}
