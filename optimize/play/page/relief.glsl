// Light on the pad in the page: the skin's irradiance on a grid, times how a face at a place sees
// the ring of distant lights that the facets of the sites tell of. The touch casts soft shadows.

struct Light { vec3 here; };

uniform sampler2D skin;                  // irradiance on the flat coating, over the pad
uniform sampler2DArray ring;             // irradiance of every light of the ring, over the sites
uniform vec3 ring_direction[RING];       // towards them, in the site's frame; the last one head on
uniform vec2 ring_first, ring_step, ring_count;
uniform vec2 skin_half;                  // half width and length of the pad
vec3 from_pyramid;
float shadow_radius = 0.0;

#ifdef FACES
uniform vec4 facet_planes[FACES];  // outward normal in the touch's frame, distance from its center

// 1 where the way to a light passes the touch, falling to 0 behind it.
float past_touch(vec3 arrive) {
    float enter = 0.0, leave = 1e9;
    for (int i = 0; i < FACES; ++i) {
        float speed = dot(facet_planes[i].xyz, arrive);
        float room = facet_planes[i].w - dot(facet_planes[i].xyz, from_pyramid);
        if (speed < 0.0) enter = max(enter, room / speed);
        else leave = min(leave, room / max(speed, 1e-9));
    }
    return 1.0 - smoothstep(0.0, 0.5 * shadow_radius, leave - enter);
}
#endif

Light irradiance(vec3 position, vec3 normal, int first, int list) {
    vec2 place = ((position.xy - ring_first) / ring_step + 0.5) / ring_count;
    vec3 facing = vec3(0.0), flat_ = vec3(0.0);
    for (int i = 0; i < RING; ++i) {
        vec3 sent = texture(ring, vec3(place, float(i))).rgb;
        flat_ += sent * max(-ring_direction[i].z, 0.0);
        float seen = max(dot(ring_direction[i], normal), 0.0);
#ifdef FACES
        if (i + 1 < RING && length(from_pyramid.xy) < shadow_radius)
            seen *= past_touch(ring_direction[i]);
#endif
        facing += sent * seen;
    }
    vec3 untouched = texture(skin, 0.5 * position.xy / skin_half + 0.5).rgb;
    return Light(untouched * facing / max(flat_, vec3(1e-6)));
}
