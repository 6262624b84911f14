// The shading function: direct irradiance at a point of the pad from a list of secondary lights,
// once straight and once by way of the lower face, per channel.

uniform sampler2D lights;     // (light, list): x, y, z in flat pad coordinates (mm), edge 0, 1, 2
uniform sampler2D emissions;  // (light * EMISSION_TEXELS + texel, list * CHANNELS + channel)
uniform int light_count;

#if CHANNELS == 3
#define Spectrum vec3
#else
#define Spectrum float
#endif

#ifdef BEAM
uniform float inverse_width;  // 1 / (2 sigma_v), rad^-1
#endif

// A local direction in the frame of an edge: along it, into the pad, towards the coating.
vec3 to_edge(vec3 direction, float edge) {
    if (edge == 1.0) return vec3(direction.x, -direction.y, direction.z);
    return vec3(direction.y, edge == 0.0 ? direction.x : -direction.x, direction.z);
}

#ifdef BEAM

// A bare fiber end behind the pad's smooth edge: Gaussian about its beam in air, refracted into
// the pad. (beam, peak intensity in air) is the emission.
float intensity(vec3 d, int light, int row) {
    vec4 emission = texelFetch(emissions, ivec2(light, row), 0);
    vec2 side = refractive_index * d.xz;
    float squared = 1.0 - dot(side, side);
    if (d.y <= 0.0 || squared <= 0.0) return 0.0;
    vec3 air = vec3(side.x, sqrt(squared), side.y);
    float cosine = dot(air, emission.xyz);
    float theta = atan(length(cross(air, emission.xyz)), cosine) * inverse_width;
    float solid_angle = refractive_index * refractive_index * d.y / air.y;
    float passed = 1.0 - reflectance(d.y);
    return emission.w * exp(-theta * theta) * max(cosine, 0.0) * passed * solid_angle;
}

#else

// The glow of a diffuser: a polynomial radiance (render.slab.directional_terms) times the cosine.
float intensity(vec3 d, int light, int row) {
    vec4 low = texelFetch(emissions, ivec2(light * EMISSION_TEXELS, row), 0);
    vec4 high = texelFetch(emissions, ivec2(light * EMISSION_TEXELS + 1, row), 0);
    float last = texelFetch(emissions, ivec2(light * EMISSION_TEXELS + 2, row), 0).x;
    float radiance = dot(low, vec4(1.0, d.x, d.z, d.x * d.x))
        + dot(high, vec4(d.x * d.z, d.z * d.z, d.y, d.y * d.x)) + last * d.y * d.z;
    return radiance * max(d.y, 0.0);
}

#endif

Spectrum arriving(Path path, vec3 normal, float edge, int light, int list) {
    vec3 d = to_edge(path.depart, edge);
    float received = path.spread * max(dot(path.arrive, normal), 0.0);
#if CHANNELS == 3
    return received * vec3(intensity(d, light, 3 * list), intensity(d, light, 3 * list + 1),
                           intensity(d, light, 3 * list + 2));
#else
    return received * intensity(d, light, list);
#endif
}

// Direct irradiance (1/mm^2 per unit power) at a flat pad position with a local unit normal.
// `first` is the row of `lights`, `list` the row (group) of `emissions`.
Spectrum irradiance(vec3 position, vec3 normal, int first, int list) {
    Spectrum sum = Spectrum(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec4 light = texelFetch(lights, ivec2(i, first), 0);
        sum += arriving(direct_path(light.xyz, position), normal, light.w, i, list);
        sum += arriving(mirrored_path(light.xyz, position), normal, light.w, i, list);
    }
    return sum;
}
