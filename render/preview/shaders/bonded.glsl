// Light of lamps in air through a flat pad and a window of another index under it, which meet at
// z = bond; z = 0 is the window's lower face. Along a ray the components of momentum (index times
// unit direction) parallel to a face it passes stay the same, and so do px and py behind the face
// that it enters by: they fix the whole ray.

const int BOND_STEPS = 14;

// The way that enters the pad and meets neither bond nor lower face. `depart` is the direction in
// air, and `spread` per intensity there.
Path clear_path(vec3 lamp, vec3 target, int face) {
    int axis = face == 0 || face == 2 ? 0 : 1;
    float way = face == 1 || face == 2 ? -1.0 : 1.0, factor;
    float plane = way > 0.0 ? box_low[axis] : box_high[axis];
    vec3 image = lamp;
    image[axis] = plane + refractive_index * (lamp[axis] - plane);
    vec3 seen = seen_through(image, target, face, factor);
    Path path = direct_path(seen, target, vec2(0.0, 1.0));
    vec3 momentum = refractive_index * path.depart;
    float ahead = way * momentum[axis];
    momentum[axis] = 0.0;
    float squared = 1.0 - dot(momentum, momentum);
    if (factor == 0.0 || ahead <= 0.0 || squared <= 0.0) return Path(path.depart, path.arrive, 0.0);
    float air = sqrt(squared), n = refractive_index;
    momentum[axis] = way * air;
    float solid_angle = n * ahead / air;
    return Path(momentum, path.arrive, path.spread * factor * solid_angle * passes(air, ahead, 1.0, n));
}

// The way through the bond: up from the window, or by way of its lower face (`mirrored`), where
// light may have entered the window or the pad above it. As `clear_path`.
//
// With H the heights in the medium that is entered and in the other, q the momenta upwards there,
// o the way to an edge in air and a the momentum along it, the ray lands at
//     x = px (H1 / q1 + H2 / q2) + o (1 - px / a),  y = py (H1 / q1 + H2 / q2),
// which is the gradient of a convex function (Fermat's principle): Newton's method finds px and py,
// and the determinant of its matrix is the area that a beam spreads over.
Path bonded_path(vec3 lamp, vec3 target, int face, bool by_window, bool mirrored) {
    const Path nothing = Path(vec3(0.0, 0.0, 1.0), vec3(0.0, 0.0, -1.0), 0.0);
    bool lower = face == 4;
    int axis = face == 1 || face == 3 ? 1 : 0, side = 1 - axis;
    float way = face == 1 || face == 2 ? -1.0 : 1.0;
    float plane = way > 0.0 ? box_low[axis] : box_high[axis];
    float n1 = by_window ? window_index : refractive_index;
    float n2 = by_window ? refractive_index : window_index;
    float over = target.z - bond;
    vec2 height = by_window ? vec2(mirrored ? lamp.z + bond : bond - lamp.z, over)
        : vec2(lamp.z - bond + over, 2.0 * bond);
    float in_air = 0.0, outside = 0.0, least = 0.0, most = min(n1, n2);
    if (lower) {
        height.x = bond;
        in_air = max(-lamp.z, 1e-4);
        most = 1.0;
    } else {
        outside = max(way * (plane - lamp[axis]), 1e-4);
        least = sqrt(n1 * n1 - 1.0);
    }
    vec2 to = vec2(way * (target[axis] - lamp[axis]) - outside, target[side] - lamp[side]);
    if (height.x <= 0.0 || height.y <= 0.0 || least >= most || (!lower && to.x <= 0.0))
        return nothing;
    float total = height.x + height.y + in_air;
    vec2 p = to * (0.98 * most * inversesqrt(dot(to, to) + total * total));
    if (!lower) {
        p.x = max(p.x, mix(least, most, 0.1));
        float room = sqrt(max(0.96 * most * most - p.x * p.x, 0.0));
        p.y = clamp(p.y, -room, room);
    }
    vec3 q;
    vec2 miss;
    float a, determinant;
    for (int i = 0; i < BOND_STEPS; ++i) {
        q = sqrt(max(vec3(n1 * n1, n2 * n2, 1.0) - dot(p, p), 1e-7));
        vec3 rate = vec3(height, in_air) / q;
        float slope = rate.x + rate.y + rate.z;
        float bent = dot(rate, 1.0 / (q * q));
        a = sqrt(max(p.x * p.x - least * least, 1e-7));
        miss = slope * p - to;
        vec3 matrix = slope * vec3(1.0, 0.0, 1.0) + bent * vec3(p.x * p.x, p.x * p.y, p.y * p.y);
        if (!lower) {
            miss.x -= outside * p.x / a;
            matrix.x += outside * least * least / (a * a * a);
        }
        determinant = matrix.x * matrix.z - matrix.y * matrix.y;
        vec2 next = p - vec2(matrix.z * miss.x - matrix.y * miss.y,
                             matrix.x * miss.y - matrix.y * miss.x) / determinant;
        // Where a step leaves the momenta that there are, it goes half the way to their border.
        float size = length(next);
        if (size >= most) next *= 0.5 * (length(p) + most) / size;
        if (!lower) next.x = max(next.x, 0.5 * (p.x + least));
        p = next;
    }
    if (!(length(miss) < 1e-2 * total)) return nothing;
    vec3 entry = lamp;
    if (lower) {
        entry += vec3(p.x, p.y, 0.0) * (in_air / q.z);
        entry.z = 0.0;
        if (any(greaterThan(abs(entry.xy), clear_half))) return nothing;
    } else {
        entry[axis] = plane;
        entry[side] += outside * p.y / a;
        entry.z += (mirrored ? -1.0 : 1.0) * outside * q.x / a;
        bool enters = all(greaterThanEqual(entry, box_low)) && all(lessThanEqual(entry, box_high));
        if (!enters || (entry.z < bond) != by_window) return nothing;
    }
    float in_pad = by_window ? q.y : q.x, in_window = by_window ? q.x : q.y;
    float passed = passes(q.x, q.y, n1, n2) * passes(lower ? q.z : a, lower ? q.x : p.x, 1.0, n1);
    if (!by_window) passed *= passes(q.x, q.y, n1, n2);
    if (mirrored && dot(p, p) < 1.0) passed *= 1.0 - passes(in_window, q.z, window_index, 1.0);
    // Of the solid angle in air, dpx dpy / (momentum out of the plane of x and y).
    float spread = passed * (lower ? 1.0 / q.z : p.x / (q.x * a)) / determinant;
    vec3 depart, arrive;
    depart[axis] = lower ? p.x : way * a;
    depart[side] = p.y;
    depart.z = lower ? q.z : mirrored ? -q.x : q.x;
    arrive[axis] = -way * p.x;
    arrive[side] = -p.y;
    arrive.z = -in_pad;
    return Path(depart, arrive / refractive_index, spread * refractive_index / in_pad);
}

#ifdef EMBEDDED

// The way from a lamp in the pad or in the window, straight or by way of the window's lower face.
// As `bonded_path`, with one component p of momentum along the faces; `spread` is per intensity in
// what the lamp is in.
Path embedded_path(vec3 lamp, vec3 target, bool mirrored) {
    bool by_window = lamp.z < bond;
    if (!by_window && !mirrored) return direct_path(lamp, target, vec2(0.0, 1.0));
    float n1 = by_window ? window_index : refractive_index;
    float n2 = by_window ? refractive_index : window_index;
    float over = target.z - bond;
    vec2 height = by_window ? vec2(mirrored ? lamp.z + bond : bond - lamp.z, over)
        : vec2(lamp.z - bond + over, 2.0 * bond);
    vec2 to = target.xy - lamp.xy;
    float reach = length(to), most = min(n1, n2);
    float p = 0.98 * most * reach * inversesqrt(reach * reach + dot(height, vec2(1.0)) * dot(height, vec2(1.0)));
    vec2 q;
    float slope, stretch;
    for (int i = 0; i < BOND_STEPS; ++i) {
        q = sqrt(max(vec2(n1 * n1, n2 * n2) - p * p, 1e-7));
        slope = height.x / q.x + height.y / q.y;
        stretch = slope + p * p * (height.x / (q.x * q.x * q.x) + height.y / (q.y * q.y * q.y));
        float next = p - (slope * p - reach) / stretch;
        p = next >= most ? 0.5 * (p + most) : max(next, 0.0);
    }
    float in_pad = by_window ? q.y : q.x, in_window = by_window ? q.x : q.y;
    float passed = passes(q.x, q.y, n1, n2);
    if (!by_window) passed *= passed;
    if (mirrored && p < 1.0) passed *= 1.0 - passes(in_window, sqrt(1.0 - p * p), window_index, 1.0);
    float spread = passed / (n1 * q.x * slope * stretch);
    vec2 way = to / max(reach, 1e-9);
    vec3 depart = vec3(p * way, mirrored ? -q.x : q.x) / n1;
    return Path(depart, vec3(-p * way, -in_pad) / refractive_index,
                spread * refractive_index / in_pad);
}

#endif
