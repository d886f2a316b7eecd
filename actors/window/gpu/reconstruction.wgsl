// What is shown between samples. The CPU passes are foveal::splatting::reconstruction and pull_push; names as there.

struct View {
    // Picture width and height.
    size: vec2u,
    // Share by which depths of one surface may differ per pixel between them.
    slope: f32,
    // Radiance that is displayed as white.
    white: f32,
    // Least and most share by which depths of one surface may differ.
    depth_shares: vec2f,
    // 1: all samples of a surface are mixed, however they lie; 0: what lies between samples is linear.
    is_smooth: u32,
    // Samples that a cell needs to show nothing but their mean.
    enough: f32,
    // Of each level: width, height, its first cell, and the side of a cell in pixels.
    levels: array<vec4u, LEVELS>,
}

// A cell of one surface.
struct Cell {
    // Pulled: the sum of the samples and their number. Pushed: what is shown, and 1 where it is known.
    samples: vec4f,
    // Object, and bits of the depth.
    key: vec2u,
}

const LEVELS: u32 = 5u;

const EXACT: u32 = 0xffffffffu;
const APPROXIMATED: u32 = 1u;
const FRESH_BONUS: u32 = 1u;
// Of a warped sample on its own pixel.
const OWN: u32 = 0x80000000u;
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
// Of all levels, the finest first.
@group(0) @binding(8) var<storage, read_write> cells: array<Cell>;
// The level that is pulled or pushed.
@group(0) @binding(9) var<uniform> level: vec4u;

// Level set of the sample that has a rank; NONE where that is none.
fn level_of(rank: u32) -> u32 {
    if rank <= APPROXIMATED {
        return NONE;
    }
    if rank == EXACT {
        return 0u;
    }
    let is_fresh = (rank & 0xffffu) == 0xffffu;
    return K_LIMIT - (((rank & ~OWN) >> 16u) - 1u - select(0u, FRESH_BONUS, is_fresh));
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

fn alike(a: vec2u, b: vec2u, pixels: f32) -> bool {
    let depth = bitcast<f32>(a.y);
    let tolerance = depth * clamp(view.slope * pixels, view.depth_shares.x, view.depth_shares.y);
    return a.x == b.x && abs(depth - bitcast<f32>(b.y)) <= tolerance;
}

fn key_of(p: vec2u) -> vec2u {
    return vec2u(textureLoad(objects, p, 0).x, bitcast<u32>(textureLoad(depths, p, 0).x));
}

// What a pixel's own sample shows, and 1 if it has one.
fn sample_of(p: vec2u) -> vec4f {
    let i = p.y * view.size.x + p.x;
    if level_of(ranks[i]) == NONE || details[i].x != (p.x | (p.y << 16u)) {
        return vec4f(0.0);
    }
    return vec4f(min(halves(colors[i]).rgb, vec3f(view.white)), 1.0);
}

// One of the four that a cell consists of.
fn child(p: vec2u) -> Cell {
    if level.x == 0u {
        if any(p >= view.size) {
            return Cell(vec4f(0.0), vec2u(0u));
        }
        return Cell(sample_of(p), key_of(p));
    }
    let finer = view.levels[level.x - 1u];
    if any(p >= finer.xy) {
        return Cell(vec4f(0.0), vec2u(0u));
    }
    let cell = cells[finer.z + p.y * finer.x + p.x];
    return Cell(cell.samples * (view.enough / max(cell.samples.w, view.enough)), cell.key);
}

@compute @workgroup_size(64)
fn pull(@builtin(global_invocation_id) id: vec3u) {
    let own = view.levels[level.x];
    if any(id.xy >= own.xy) {
        return;
    }
    let p = id.xy * 2u;
    var children = array(child(p), child(p + vec2u(1u, 0u)), child(p + vec2u(0u, 1u)), child(p + vec2u(1u, 1u)));
    let side = f32(own.w / 2u);
    var best = Cell(vec4f(0.0), children[0].key);
    var most = 0u;
    for (var i = 0u; i < 4u; i++) {
        let key = children[i].key;
        if key.x == 0u {
            continue;
        }
        var votes = 0u;
        var sum = vec4f(0.0);
        for (var j = 0u; j < 4u; j++) {
            if alike(key, children[j].key, side) {
                votes += 1u;
                sum += children[j].samples;
            }
        }
        if votes > most {
            most = votes;
            best = Cell(sum, key);
        }
    }
    cells[own.z + id.y * own.x + id.x] = best;
}

// What a level shows at the middle of a cell of the next finer one, or of a pixel; w is 0 where that is nothing.
fn around(n: u32, p: vec2u, key: vec2u) -> vec4f {
    let coarser = view.levels[n];
    let parent = vec2i(p / 2u);
    let side = vec2i(p % 2u) * 2 - 1;
    var sum = vec4f(0.0);
    for (var k = 0; k < 4; k++) {
        let step = vec2i(k & 1, k >> 1u);
        let q = parent + step * side;
        if any(q < vec2i(0)) || any(q >= vec2i(coarser.xy)) {
            continue;
        }
        let cell = cells[coarser.z + u32(q.y) * coarser.x + u32(q.x)];
        if alike(key, cell.key, f32(coarser.w)) {
            let weight = select(0.75, 0.25, step.x == 1) * select(0.75, 0.25, step.y == 1);
            sum += cell.samples * weight;
        }
    }
    return select(vec4f(0.0), vec4f(sum.rgb / sum.w, 1.0), sum.w > 0.0);
}

// What a cell of these samples shows amid what is coarser; w is 0 where that is nothing.
fn mixed(samples: vec4f, coarse: vec4f) -> vec4f {
    if samples.w <= 0.0 {
        return coarse;
    }
    let mean = vec4f(samples.rgb / samples.w, 1.0);
    return select(mean, mix(coarse, mean, min(samples.w / view.enough, 1.0)), coarse.w > 0.5);
}

@compute @workgroup_size(64)
fn push(@builtin(global_invocation_id) id: vec3u) {
    let own = view.levels[level.x];
    if any(id.xy >= own.xy) {
        return;
    }
    let i = own.z + id.y * own.x + id.x;
    var coarse = vec4f(0.0);
    if level.x + 1u < LEVELS {
        coarse = around(level.x + 1u, id.xy, cells[i].key);
    }
    cells[i].samples = mixed(cells[i].samples, coarse);
}

// Whether all pixels of an object in a block of 2 x 2 show samples of their own.
fn is_dense(p: vec2u) -> bool {
    let object = textureLoad(objects, p, 0).x;
    for (var k = 0u; k < 4u; k++) {
        let q = vec2u(p.x ^ (k & 1u), p.y ^ (k >> 1u));
        if all(q < view.size) && textureLoad(objects, q, 0).x == object && sample_of(q).w < 0.5 {
            return false;
        }
    }
    return true;
}

// What a pixel without guide shows of all samples around; w is 0 where it shows what lies there.
fn amid(p: vec2u) -> vec4f {
    let coarse = around(0u, p, key_of(p));
    if coarse.w < 0.5 || is_dense(p) {
        return vec4f(0.0);
    }
    return mixed(sample_of(p), coarse);
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
    let source = unpack2x16float(own.y).y;
    if view.is_smooth == 1u && k != NONE && guide.w < 0.5 {
        let found = amid(id.xy);
        if found.w > 0.5 {
            shown[i] = vec2u(pack2x16float(found.rg), pack2x16float(vec2f(found.b, source)));
        }
        return;
    }
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
    shown[i] = vec2u(pack2x16float(rgb.rg), pack2x16float(vec2f(rgb.b, source)));
}
