// One cell of the transport array: a list of lights at a point of the pad. Lists, of fiber * nodes +
// node, lie above each other, each as a block of points.

// Position, normal and, on a skin that is not flat, the skin's normal: POINT_COLUMNS points per row.
// Of what pixels see: position, normal and the way from the body next to it, with that body's number,
// or -1 where no shadow falls. Of what the camera sees of a lobe, last the direction to it.
uniform sampler2D points;
uniform int first_point, last_point;
uniform ivec2 block;  // columns and rows of a list's points
uniform int nodes;
#ifdef PIXELS
#ifdef FACES
uniform float longest_shadow;  // mm from a body's center
#endif
#endif

#if CHANNELS == 3
out vec3 cell;
#else
out vec2 cell;  // at the point, at the foot of its facet
#endif

void main() {
    ivec2 place = ivec2(gl_FragCoord.xy);
    int list = place.y / block.y;
    int point = min(first_point + (place.y % block.y) * block.x + place.x, last_point);
    ivec2 texel = ivec2(POINT_TEXELS * (point % POINT_COLUMNS), point / POINT_COLUMNS);
#ifdef LOBE
    sight = texelFetch(points, texel + ivec2(POINT_TEXELS - 1, 0), 0).xyz;
#endif
    vec3 position = texelFetch(points, texel, 0).xyz;
    vec3 normal = texelFetchOffset(points, texel, 0, ivec2(1, 0)).xyz;
#ifdef PIXELS
#ifdef FACES
    vec4 body = texelFetchOffset(points, texel, 0, ivec2(2, 0));
    from_pyramid = body.xyz;
    if (body.w >= 0.0) shadow_radius = longest_shadow;
#ifdef CURVED
    pyramid_frame = frame_of(max(int(body.w), 0));
#endif
#endif
#elif defined(CURVED)
    below = texelFetchOffset(points, texel, 0, ivec2(2, 0)).xyz;
#endif
    Light light = irradiance(position, normal, list / nodes, list);
#if CHANNELS == 3
    cell = light.here;
#else
    cell = vec2(light.here, light.foot);
#endif
}
