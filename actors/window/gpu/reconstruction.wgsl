// What is shown between samples: linear instead of constant. Twin of foveal::splatting::reconstruction; names as there.

struct View {
    // Picture width and height.
    size: vec2u,
    // Share by which depths of one surface may differ per pixel between them, and whatever lies between.
    slope: f32,
    depth_share: f32,
    // Radiance that is displayed as white.
    white: f32,
    padding_x: f32,
    padding_y: f32,
    padding_z: f32,
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
@group(0) @binding(4) var<storage, read> places: array<u32>;
// Three halves of radiance and source + 1.
@group(0) @binding(5) var<storage, read> colors: array<vec2u>;
@group(0) @binding(6) var<storage, read_write> shown: array<vec2u>;

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

fn color_at(i: u32) -> vec4f {
    let packed = colors[i];
    return vec4f(unpack2x16float(packed.x), unpack2x16float(packed.y));
}

struct Sum {
    // Radiance times weight, and the weight.
    weighted: vec4f,
    // Whether no corner is missing that is on the pixel's surface.
    is_whole: bool,
}

// Weighted sum over the corners that count for a pixel.
fn sum(p: vec2i, k: u32, corners: array<vec2i, 4>, weights: array<f32, 4>) -> Sum {
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
        let tolerance = depth * max(view.slope * distance, view.depth_share);
        if textureLoad(objects, q, 0).x != object || !(abs(textureLoad(depths, q, 0).x - depth) <= tolerance) {
            continue;
        }
        let at = u32(q.y * size.x + q.x);
        let of = level_of(ranks[at]);
        let is_own = places[at] == (u32(q.x) | (u32(q.y) << 16u));
        if of != NONE && (of <= k || is_own) {
            out.weighted += vec4f(min(color_at(at).rgb, vec3f(view.white)), 1.0) * w[i];
        } else {
            out.is_whole = false;
        }
    }
    return out;
}

// The value of a pixel that shows the sample of level set `own` at `s`; weight 0 where no corner counts.
fn between(p: vec2i, s: vec2i, own: u32) -> vec4f {
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
        let found = sum(p, k, corners, weights);
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
    let k = level_of(ranks[i]);
    if k == NONE || k == 0u {
        return;
    }
    let place = places[i];
    let s = vec2i(vec2u(place & 0xffffu, place >> 16u));
    let found = between(vec2i(id.xy), s, k);
    if found.a > 0.0 {
        let rgb = found.rgb / found.a;
        let source = unpack2x16float(own.y).y;
        shown[i] = vec2u(pack2x16float(rgb.rg), pack2x16float(vec2f(rgb.b, source)));
    }
}
