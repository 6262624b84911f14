// One cell of the transport array: column = point of the pad, row = fiber * nodes + node.

// Position, normal, where it is not flat the skin's normal, where it has a lobe the direction to the
// camera: POINT_COLUMNS points per row.
uniform sampler2D points;
uniform int first_point;
uniform int nodes;

#if CHANNELS == 3
out vec3 cell;
#else
out vec2 cell;  // at the point, at the foot of its facet
#endif

void main() {
    int point = int(gl_FragCoord.x) + first_point, list = int(gl_FragCoord.y);
    int parts = 2;
#ifdef CURVED
    ++parts;
#endif
#ifdef LOBE
    ++parts;
#endif
    ivec2 texel = ivec2(parts * (point % POINT_COLUMNS), point / POINT_COLUMNS);
#ifdef CURVED
    below = texelFetchOffset(points, texel, 0, ivec2(2, 0)).xyz;
#endif
#ifdef LOBE
    sight = texelFetch(points, texel + ivec2(parts - 1, 0), 0).xyz;
#endif
    vec3 position = texelFetch(points, texel, 0).xyz;
    vec3 normal = texelFetchOffset(points, texel, 0, ivec2(1, 0)).xyz;
    Light light = irradiance(position, normal, list / nodes, list);
#if CHANNELS == 3
    cell = light.here;
#else
    cell = vec2(light.here, light.foot);
#endif
}
