// What is pressed in, as planes of a convex body, and where its shadow falls.

#ifdef FACES

uniform vec4 facet_planes[FACES];  // outward normal in the body's frame, distance from its center
// The coating's point from the nearest body's center; beyond shadow_radius nothing is tested.
uniform float body_reach;  // mm around the center's axis, within which all of the body lies
vec3 from_pyramid;
float shadow_radius = 0.0;
#ifdef CURVED
uniform sampler2D site_frames;  // position, across, towards the tip, out of the pad; a row per body
mat3 pyramid_frame;  // across, towards the tip, out of the pad

vec3 center_of(int site) { return texelFetch(site_frames, ivec2(0, site), 0).xyz; }

mat3 frame_of(int site) {
    return mat3(texelFetch(site_frames, ivec2(1, site), 0).xyz,
                texelFetch(site_frames, ivec2(2, site), 0).xyz,
                texelFetch(site_frames, ivec2(3, site), 0).xyz);
}

#ifdef CARRIED
// Sites that a state of the skin carries out of their grid.
int nearest_site(vec2 place) {
    int nearest = 0;
    for (int site = 1; site < textureSize(site_frames, 0).y; ++site) {
        if (distance(place, center_of(site).xy) < distance(place, center_of(nearest).xy)) {
            nearest = site;
        }
    }
    return nearest;
}
#endif
#endif

// 1 where the way from a point of the coating towards a light passes the body, 0 behind it. Its
// frame is taken for the point's own, as shadows are short against the radius of the bend.
float past_pyramid(vec3 arrive) {
    // Inside the pad a body is nowhere wider than at the coating: most rays pass beside it.
    float beside = abs(from_pyramid.x * arrive.y - from_pyramid.y * arrive.x);
    if (arrive.z <= 0.0 && beside > body_reach * length(arrive.xy)) return 1.0;
    float enter = 0.0, leave = 1e9;
    // Upright faces, which part most ways from the body, come last.
    for (int i = FACES - 1; i >= 0 && enter < leave; --i) {
        float speed = dot(facet_planes[i].xyz, arrive);
        float room = facet_planes[i].w - dot(facet_planes[i].xyz, from_pyramid);
        if (speed < 0.0) enter = max(enter, room / speed);
        else leave = min(leave, room / max(speed, 1e-9));
    }
    return enter < leave ? 0.0 : 1.0;
}

#endif
