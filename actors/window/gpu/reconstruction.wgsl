// What is shown between samples: linear instead of constant. The CPU pass is foveal::splatting::reconstruction; names as there.

struct View {
    // Picture width and height.
    size: vec2u,
    // Share by which depths of one surface may differ per pixel between them.
    slope: f32,
    // Radiance that is displayed as white.
    white: f32,
    // Least and most share by which depths of one surface may differ.
    depth_shares: vec2f,
    padding: vec2f,
}

const EXACT: u32 = 0xffffffffu;
const APPROXIMATED: u32 = 1u;
const FRESH_BONUS: u32 = 1u;
const K_LIMIT: u32 = 9u;
// No sample.
const NONE: u32 = 0xffffffffu;

@group(0) @binding(0) var<uniform> view: View;
@group(0) @binding(1) var objects: texture_2d<u32>;
@group(0) @binding(2) var depths: texture_2d<f32>;
@group(0) @binding(3) var<storage, read> ranks: array<u32>;
// Of the sample that is shown: its place, and three halves of what its guide showed; the fourth is 1 where it has one.
@group(0) @binding(4) var<storage, read> details: array<vec4u>;
// Three halves of radiance and source + 1.
@group(0) @binding(5) var<storage, read> colors: array<vec2u>;
// What the guides of pixels show, and 1 where there is one.
@group(0) @binding(6) var<storage, read> guides: array<vec2u>;
@group(0) @binding(7) var<storage, read_write> shown: array<vec2u>;

// Level set of the sample that has a rank; NONE where that is none.
fn level_of(rank: u32) -> u32 {
    if rank <= APPROXIMATED {
        return NONE;
    }
    if rank == EXACT {
        return 0u;
    }
    let is_fresh = (rank & 0xffffu) == 0xffffu;
    return K_LIMIT - ((rank >> 16u) - 1u - select(0u, FRESH_BONUS, is_fresh));
}

fn halves(packed: vec2u) -> vec4f {
    return vec4f(unpack2x16float(packed.x), unpack2x16float(packed.y));
}

// What the sample shown at a pixel is carried to another as: its difference from its guide where that pixel has a guide;
// w is 0 where that has one and the sample has not.
fn value(i: u32, guide: vec4f) -> vec4f {
    let white = vec3f(view.white);
    let color = min(halves(colors[i]).rgb, white);
    if guide.w < 0.5 {
        return vec4f(color, 1.0);
    }
    let carried = halves(details[i].yz);
    return vec4f(color - min(carried.rgb, white), select(0.0, 1.0, carried.w > 0.5));
}

// What a pixel shows of such a value.
fn led(value: vec3f, guide: vec4f) -> vec3f {
    if guide.w < 0.5 {
        return value;
    }
    return max(value + min(guide.rgb, vec3f(view.white)), vec3f(0.0));
}

struct Sum {
    // Radiance times weight, and the weight.
    weighted: vec4f,
    // Whether no corner is missing that is on the pixel's surface.
    is_whole: bool,
}

// Weighted sum over the corners that count for a pixel.
fn sum(p: vec2i, k: u32, guide: vec4f, corners: array<vec2i, 4>, weights: array<f32, 4>) -> Sum {
    let size = vec2i(view.size);
    let object = textureLoad(objects, p, 0).x;
    let depth = textureLoad(depths, p, 0).x;
    var out = Sum(vec4f(0.0), true);
    // What is indexed by a variable has to be one.
    var c = corners;
    var w = weights;
    for (var i = 0; i < 4; i++) {
        let q = c[i];
        if w[i] <= 0.0 || any(q < vec2i(0)) || any(q >= size) {
            continue;
        }
        let distance = f32(abs(q.x - p.x) + abs(q.y - p.y));
        let tolerance = depth * clamp(view.slope * distance, view.depth_shares.x, view.depth_shares.y);
        if textureLoad(objects, q, 0).x != object || !(abs(textureLoad(depths, q, 0).x - depth) <= tolerance) {
            continue;
        }
        let at = u32(q.y * size.x + q.x);
        let level = level_of(ranks[at]);
        let is_own = details[at].x == (u32(q.x) | (u32(q.y) << 16u));
        let carried = value(at, guide);
        if level != NONE && (level <= k || is_own) && carried.w > 0.5 {
            out.weighted += carried * w[i];
        } else {
            out.is_whole = false;
        }
    }
    return out;
}

// The value of a pixel that shows the sample of level set `own` at `s`; weight 0 where no corner counts.
fn between(p: vec2i, s: vec2i, own: u32, guide: vec4f) -> vec4f {
    let d = p - s;
    var a = 1;
    var b = 0;
    for (var k = 1u; k <= own; k++) {
        let next = 2 * a + b;
        b = 2 * b - a;
        a = next;
        let u = d.x * a + d.y * b;
        let v = d.y * a - d.x * b;
        let area = a * a + b * b;
        if k < own && 2 * max(abs(u), abs(v)) > area {
            continue;
        }
        let along = min(f32(abs(u)) / f32(area), 1.0);
        let across = min(f32(abs(v)) / f32(area), 1.0);
        let next_u = sign(u) * vec2i(a, b);
        let next_v = sign(v) * vec2i(-b, a);
        let corners = array(s, s + next_u, s + next_v, s + next_u + next_v);
        let weights = array(
            (1.0 - along) * (1.0 - across),
            along * (1.0 - across),
            (1.0 - along) * across,
            along * across,
        );
        let found = sum(p, k, guide, corners, weights);
        if found.is_whole || k == own {
            return found.weighted;
        }
    }
    return vec4f(0.0);
}

@compute @workgroup_size(64)
fn reconstruct(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= view.size.x || id.y >= view.size.y {
        return;
    }
    let i = id.y * view.size.x + id.x;
    let own = colors[i];
    shown[i] = own;
    let rank = ranks[i];
    let k = level_of(rank);
    let guide = halves(guides[i]);
    if rank == EXACT || (guide.w < 0.5 && (k == NONE || k == 0u)) {
        return;
    }
    var rgb = guide.rgb;
    if k == 0u {
        let carried = value(i, guide);
        if carried.w < 0.5 {
            return;
        }
        rgb = led(carried.rgb, guide);
    } else if k != NONE {
        let place = details[i].x;
        let found = between(vec2i(id.xy), vec2i(vec2u(place & 0xffffu, place >> 16u)), k, guide);
        if found.a <= 0.0 {
            return;
        }
        rgb = led(found.rgb / found.a, guide);
    }
    let source = unpack2x16float(own.y).y;
    shown[i] = vec2u(pack2x16float(rgb.rg), pack2x16float(vec2f(rgb.b, source)));
}
