// One cell of the transport array: column = point of the pad, row = fiber * nodes + node.

uniform sampler2D points;  // (2 * point): position, then normal
uniform int nodes;

out Spectrum cell;

void main() {
    int point = int(gl_FragCoord.x), list = int(gl_FragCoord.y);
    vec3 position = texelFetch(points, ivec2(2 * point, 0), 0).xyz;
    vec3 normal = texelFetch(points, ivec2(2 * point + 1, 0), 0).xyz;
    cell = irradiance(position, normal, list / nodes, list);
}
