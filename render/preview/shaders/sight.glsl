// What a pixel sees: its ray, refraction at the lower face, then the coating or a facet of what is
// pressed in.

uniform vec2 half_view;       // the lens's image of half the columns and half the rows
uniform vec3 camera;          // world
uniform vec3 leftward, upward, ahead;  // in the camera's picture; ours is its mirror image
uniform float pivot;          // y at which the bent pad touches the plane of the flat one
#ifndef CURVED
uniform vec2 half_pad;        // half width and length of the pad
#endif
#ifdef FACES
uniform vec3 site_first;      // flat position of the first site
uniform vec2 site_step, site_count;
#endif
#ifdef CURVED
const int STEPS = 32, HALVINGS = 16;

// Way to `sunk` mm below the skin's height: the first step in which a ray crosses it; negative where
// it passes.
float way_to_skin(vec3 start, vec3 way, float sunk) {
    // A ray parallel to an edge has that edge at infinity; sign() would make it 0 / 0.
    vec2 ends = ((2.0 * step(0.0, way.xy) - 1.0) * half_pad - start.xy) / way.xy;
    float last = min((thickness - start.z) / way.z, min(ends.x, ends.y));
    float before = 0.0, after = -1.0;
    for (int i = 1; i <= STEPS; ++i) {
        float here = last * float(i) / float(STEPS);
        vec3 place = start + here * way;
        if (place.z >= skin_at(place.xy).w - sunk - 1e-5) { after = here; break; }
        before = here;
    }
    if (after < 0.0) return -1.0;
    for (int i = 0; i < HALVINGS; ++i) {
        float middle = 0.5 * (before + after);
        vec3 place = start + middle * way;
        if (place.z >= skin_at(place.xy).w - sunk) after = middle; else before = middle;
    }
    return after;
}
#endif

struct Seen {
    vec3 position, facing;  // flat coordinates, and the local normal into the pad
    float passed;           // of light through the lower face
    int facet, site;        // face of the body next to it; no face is -1
    vec3 from_body;         // from that body's center, in its frame
#ifdef LOBE
    vec3 to_camera;         // unit direction in the pad, in the local frame
#endif
};

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

#ifdef HEIGHT_MAP
vec3 flat_place(vec3 world) {
#ifdef CURVED
    return world;
#else
    vec2 turn;
    return unbend(world, turn);
#endif
}

// Whether a place in the world lies at or behind the pressed skin.
bool behind_skin(vec3 world) {
    vec3 place = flat_place(world);
    return pressed_at(place.xy) >= level_at(place.xy) - place.z;
}
#endif

// Whether the pad is seen at a place of the picture, whose sides reach from -1 to 1.
bool look(vec2 image, out Seen seen) {
    vec2 side = half_view * image;
#ifdef FISHEYE
    float angle = max(length(side), 1e-9);
    vec3 aim = vec3(side * sin(angle) / angle, cos(angle));
#else
    vec3 aim = vec3(side, 1.0);
#endif
    vec3 ray = normalize(aim.x * leftward + aim.y * upward + aim.z * ahead);
    vec3 start = camera - vec3(0.0, pivot, 0.0);
    float bend = curved / (1.0 + curved * thickness);
    float way = way_to_arc(bend, start, ray);
    if (way < 0.0) return false;
    vec3 entry = start + way * ray;
    vec3 normal = normalize(vec3(0.0, bend * entry.yz - vec2(0.0, 1.0)));
    float cos_in = -dot(ray, normal);
    vec3 inside = refract(ray, normal, 1.0 / refractive_index);
    seen.passed = 1.0 - reflectance(-dot(inside, normal));
#ifdef BONDED
    // The pad is flat: its window's lower face is z = 0, and the bond is parallel to it.
    vec3 across = vec3(ray.xy, 0.0);
    float squared = dot(across, across);
    vec2 rise = sqrt(vec2(window_index * window_index, refractive_index * refractive_index) - squared);
    seen.passed = passes(ray.z, rise.x, 1.0, window_index)
        * passes(rise.x, rise.y, window_index, refractive_index);
    entry += vec3(across.xy / rise.x, 1.0) * bond;
    inside = vec3(across.xy, rise.y) / refractive_index;
#endif
    seen.facet = -1;
    seen.site = 0;
    seen.from_body = vec3(0.0);
#ifdef CURVED
    entry.y += pivot;
    if (any(greaterThan(abs(entry.xy), half_pad))) return false;
    way = way_to_skin(entry, inside, 0.0);
    if (way < 0.0) return false;
    vec3 target = entry + way * inside;
    vec3 facing = normalize(skin_at(target.xy).xyz);
#else
    way = way_to_arc(curved, entry - vec3(0.0, 0.0, thickness), inside);
    if (way < 0.0) return false;
    vec2 turn;
    vec3 target = unbend(entry + way * inside + vec3(0.0, pivot, 0.0), turn);
    if (any(greaterThan(abs(target.xy), half_pad))) return false;
    target.z = thickness;
    vec3 facing = vec3(0.0, 0.0, -1.0);
#endif
#ifdef FACES
#ifdef CARRIED
    seen.site = nearest_site(target.xy);
#else
    vec2 number = clamp(round((target.xy - site_first.xy) / site_step), vec2(0.0), site_count - 1.0);
    seen.site = int(number.y * site_count.x + number.x);
#endif
#ifdef CURVED
    mat3 frame = frame_of(seen.site);
    vec3 from_site = (target - center_of(seen.site)) * frame;
    vec3 d = inside * frame;
#else
    vec3 from_site = target - vec3(site_first.xy + number * site_step, thickness);
    vec3 d = to_local(inside, turn);
#endif
    // The pyramid is convex: the last plane entered is the facet seen, unless another is left first.
    float enter = -1e9, leave = 0.0;
    int facet = 0;  // of the body
    for (int i = 0; i < FACES; ++i) {
        float speed = dot(facet_planes[i].xyz, d);
        float meets = (facet_planes[i].w - dot(facet_planes[i].xyz, from_site)) / speed;
        if (speed < 0.0) {
            if (meets > enter) { enter = meets; facet = i; }
        } else leave = min(leave, meets);
    }
    if (enter < leave) {
#ifdef CURVED
        facing = frame * facet_planes[facet].xyz;
        target += enter * inside;
#else
        facing = facet_planes[facet].xyz;
        target += enter * d;
#endif
        seen.facet = facet;
    } else seen.from_body = from_site;
#endif
#ifdef HEIGHT_MAP
    // From where the ray is as deep as the deepest skin to where it meets the untouched one.
#ifdef CURVED
    float first = max(way_to_skin(entry, inside, deepest), 0.0), found = way;
    vec3 from = entry;
#else
    float first = max(way - deepest / max(to_local(inside, turn).z, 0.05), 0.0), found = way;
    vec3 from = entry + vec3(0.0, pivot, 0.0);
#endif
    for (int k = 1; k <= MAX_STEPS; ++k) {
        float t = mix(first, way, float(k) / float(MAX_STEPS));
        if (behind_skin(from + t * inside)) { found = t; break; }
    }
    float before = found - (way - first) / float(MAX_STEPS);
    for (int k = 0; k < 8; ++k) {
        float t = 0.5 * (before + found);
        if (behind_skin(from + t * inside)) found = t;
        else before = t;
    }
#ifdef CURVED
    target = from + found * inside;
#else
    target = unbend(from + found * inside, turn);
#endif
    float depth = pressed_at(target.xy);
    target.z = level_at(target.xy) - depth;
    facing = skin_normal(target.xy, 1.0 + curved * depth);
#endif
    seen.position = target;
    seen.facing = facing;
#ifdef LOBE
#ifdef CURVED
    seen.to_camera = -inside;
#else
    seen.to_camera = -to_local(inside, turn);
#endif
#endif
    return true;
}
