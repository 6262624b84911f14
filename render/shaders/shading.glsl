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

// What one light sends into a direction, given in the frame of its edge.
#ifdef BEAM

// A bare fiber end behind the pad's smooth edge: Gaussian about its beam in air, refracted into
// the pad.
struct Emission {
    vec3 beam;
    float peak;  // intensity in air along the beam
};

Emission emission_of(int light, int row) {
    vec4 texel = texelFetch(emissions, ivec2(light, row), 0);
    return Emission(texel.xyz, texel.w);
}

float intensity(Emission emission, vec3 d) {
    vec2 side = refractive_index * d.xz;
    float squared = 1.0 - dot(side, side);
    if (d.y <= 0.0 || squared <= 0.0) return 0.0;
    vec3 air = vec3(side.x, sqrt(squared), side.y);
    float cosine = dot(air, emission.beam);
    float theta = atan(length(cross(air, emission.beam)), cosine) * inverse_width;
    float solid_angle = refractive_index * refractive_index * d.y / air.y;
    float passed = 1.0 - reflectance(d.y);
    return emission.peak * exp(-theta * theta) * max(cosine, 0.0) * passed * solid_angle;
}

#else

// The glow of a diffuser: a polynomial radiance (render.slab.directional_terms) times the cosine.
struct Emission {
    vec4 low, high;
    float last;
};

Emission emission_of(int light, int row) {
    ivec2 texel = ivec2(light * EMISSION_TEXELS, row);
    return Emission(texelFetch(emissions, texel, 0), texelFetchOffset(emissions, texel, 0, ivec2(1, 0)),
                    texelFetchOffset(emissions, texel, 0, ivec2(2, 0)).x);
}

float intensity(Emission emission, vec3 d) {
    float radiance = dot(emission.low, vec4(1.0, d.x, d.z, d.x * d.x))
        + dot(emission.high, vec4(d.x * d.z, d.z * d.z, d.y, d.y * d.x))
        + emission.last * d.y * d.z;
    return radiance * max(d.y, 0.0);
}

#endif

float received(Path path, vec3 normal) {
    return path.spread * max(dot(path.arrive, normal), 0.0);
}

// Direct irradiance (1/mm^2 per unit power) at a flat pad position with a local unit normal.
// `first` is the row of `lights`, `list` the row (or group of rows) of `emissions`.
Spectrum irradiance(vec3 position, vec3 normal, int first, int list) {
    Spectrum sum = Spectrum(0.0);
    for (int i = 0; i < light_count; ++i) {
        vec4 light = texelFetch(lights, ivec2(i, first), 0);
        vec2 turn = half_turn(light.xyz, position);
        Path direct = direct_path(light.xyz, position, turn);
        Path mirrored = mirrored_path(light.xyz, position, turn);
        vec3 d = to_edge(direct.depart, light.w), m = to_edge(mirrored.depart, light.w);
        float by_direct = received(direct, normal), by_mirror = received(mirrored, normal);
#if CHANNELS == 3
        for (int c = 0; c < 3; ++c) {
            Emission emission = emission_of(i, 3 * list + c);
            sum[c] += by_direct * intensity(emission, d) + by_mirror * intensity(emission, m);
        }
#else
        Emission emission = emission_of(i, list);
        sum += by_direct * intensity(emission, d) + by_mirror * intensity(emission, m);
#endif
    }
    return sum;
}
