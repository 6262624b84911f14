// Light on the pad in the page: the skin's irradiance on a grid, times how a face at a place sees
// the ring of distant lights that the facets of the sites tell of. The touch casts soft shadows.

uniform sampler2D skin_light;            // irradiance on the untouched coating, over the pad
uniform sampler2DArray ring;             // irradiance of every light of the ring, over the sites
uniform vec3 ring_direction[RING];       // towards them, in the site's frame; the last one head on
uniform vec2 ring_first, ring_step, ring_count;
uniform vec2 skin_half;                  // half width and length of the pad
uniform float longest_shadow;            // mm from the touch's center

#ifdef FACES
uniform vec4 facet_planes[FACES];  // outward normal in the touch's frame, distance from its center
#ifdef CURVED
uniform vec3 touch_frame[4];       // position, across, towards the tip, out of the pad

mat3 frame_of(int site) { return mat3(touch_frame[1], touch_frame[2], touch_frame[3]); }
vec3 center_of(int site) { return touch_frame[0]; }
#endif

// 1 where the way from a place to a light passes the touch, falling to 0 behind it.
float past_touch(vec3 from, vec3 arrive) {
    float enter = 0.0, leave = 1e9;
    for (int i = 0; i < FACES; ++i) {
        float speed = dot(facet_planes[i].xyz, arrive);
        float room = facet_planes[i].w - dot(facet_planes[i].xyz, from);
        if (speed < 0.0) enter = max(enter, room / speed);
        else leave = min(leave, room / max(speed, 1e-9));
    }
    return 1.0 - smoothstep(0.0, 0.5 * longest_shadow, leave - enter);
}
#endif

// A normal in the frame of the untouched skin at a place.
vec3 in_skin_frame(vec3 normal, vec2 place) {
#ifdef CURVED
    vec3 up = -normalize(skin_at(place).xyz);
    vec3 across = normalize(vec3(up.z, 0.0, -up.x));
    return vec3(dot(across, normal), dot(cross(up, across), normal), dot(up, normal));
#else
    return normal;
#endif
}

// Irradiance where a pixel looks: a face's place and normal, from the touch's center in its frame.
vec3 relief(vec3 position, vec3 facing, int facet, vec3 from_touch) {
    vec2 place = ((position.xy - ring_first) / ring_step + 0.5) / ring_count;
    vec3 normal = in_skin_frame(facing, position.xy);
    vec3 turned = vec3(0.0), flat_ = vec3(0.0);
    for (int i = 0; i < RING; ++i) {
        vec3 sent = texture(ring, vec3(place, float(i))).rgb;
        flat_ += sent * max(-ring_direction[i].z, 0.0);
        float seen = max(dot(ring_direction[i], normal), 0.0);
#ifdef FACES
        if (i + 1 < RING && facet < 0 && length(from_touch.xy) < longest_shadow)
            seen *= past_touch(from_touch, ring_direction[i]);
#endif
        turned += sent * seen;
    }
    vec3 untouched = texture(skin_light, 0.5 * position.xy / skin_half + 0.5).rgb;
    return untouched * turned / max(flat_, vec3(1e-6));
}
