// The splat layer: squares and tiles that replace what has a lower or equal rank, on pixels of their object. The CPU
// pass is foveal::splatting::layer; names as there.
//
// Three passes over the new splats, each for all of them: the highest rank of each pixel, the last splat of that rank, its
// colour and place. So the outcome is that of one splat after the other, in the order of their numbers.

struct Layer {
    // Picture width and height; largest k of the tile table.
    size: vec2u,
    k_max: u32,
    // Part of the rank of a warped sample on its own pixel.
    own: u32,
}

struct Group {
    // Splats of one dispatch.
    first: u32,
    count: u32,
    padding: vec2u,
}

struct Splat {
    // Column in the low, row in the high half.
    place: u32,
    object: u32,
    rank: u32,
    // Half side in the low byte, k in the next; source + 1 in ten bits of the high half, and above them the kind.
    shape: u32,
    // Depth along the view axis and how far the depth buffer may differ.
    depth: vec2f,
    // Radiance as three halves; the fourth is source + 1.
    color: vec2u,
    // What its guide showed as three halves; the fourth is 1 where it has one.
    guide: vec2u,
    // Splats are numbered from 1 in a view.
    number: u32,
    padding: u32,
}

const WARPED: u32 = 0u;
const FRESH: u32 = 1u;
const EXACT: u32 = 0xffffffffu;
const APPROXIMATED: u32 = 1u;
// Pixels that one invocation covers.
const CHUNK: u32 = 64u;

@group(0) @binding(0) var<uniform> layer: Layer;
// Per k: half side, first bit; then the bits of all tiles, rows one after another.
@group(0) @binding(1) var<storage, read> tiles: array<u32>;
@group(0) @binding(2) var objects: texture_2d<u32>;
@group(0) @binding(3) var depths: texture_2d<f32>;
@group(0) @binding(4) var<storage, read> splats: array<Splat>;
@group(0) @binding(5) var<storage, read_write> ranks: array<atomic<u32>>;
@group(0) @binding(6) var<storage, read_write> owners: array<atomic<u32>>;
@group(0) @binding(7) var<storage, read_write> colors: array<vec2u>;
// Of the sample that is shown: its place, and its guide.
@group(0) @binding(8) var<storage, read_write> details: array<vec4u>;
@group(1) @binding(0) var<uniform> group: Group;

fn matches(object: u32, depth: vec2f, p: vec2i) -> bool {
    if any(p < vec2i(0)) || any(p >= vec2i(layer.size)) {
        return false;
    }
    return textureLoad(objects, p, 0).x == object && abs(textureLoad(depths, p, 0).x - depth.x) <= depth.y;
}

// Whether a warped sample is not hidden: some pixel around it has its object at its depth.
fn is_visible(object: u32, depth: vec2f, center: vec2i) -> bool {
    if matches(object, depth, center) {
        return true;
    }
    for (var i = 0; i < 9; i++) {
        if matches(object, depth, center + vec2i(i % 3 - 1, i / 3 - 1)) {
            return true;
        }
    }
    return false;
}

// The part of a splat that an invocation covers.
struct Part {
    center: vec2i,
    object: u32,
    rank: u32,
    half: i32,
    // First bit of the tile; of squares, NO_TILE.
    tile: u32,
    first: u32,
    end: u32,
}

const NO_TILE: u32 = 0xffffffffu;

fn part(splat: u32, chunk: u32) -> Part {
    let shape = splats[splat].shape;
    let kind = shape >> 28u;
    var out: Part;
    out.center = vec2i(vec2u(splats[splat].place & 0xffffu, splats[splat].place >> 16u));
    out.object = splats[splat].object;
    out.rank = splats[splat].rank;
    out.half = i32(shape & 0xffu);
    out.tile = NO_TILE;
    if kind == FRESH {
        let k = min((shape >> 8u) & 0xffu, layer.k_max);
        out.half = i32(tiles[2u * k]);
        out.tile = tiles[2u * k + 1u] + 64u * (layer.k_max + 1u);
    }
    let side = u32(2 * out.half + 1);
    out.first = chunk * CHUNK;
    out.end = min(out.first + CHUNK, side * side);
    if out.first < out.end && kind == WARPED && !is_visible(out.object, splats[splat].depth, out.center) {
        out.end = out.first;
    }
    return out;
}

// The pixel number `i` of the part's square, or -1 where it is outside of the picture or of the tile.
fn pixel(p: Part, i: u32) -> i32 {
    if p.tile != NO_TILE {
        let bit = p.tile + i;
        if ((tiles[bit >> 5u] >> (bit & 31u)) & 1u) == 0u {
            return -1;
        }
    }
    let side = u32(2 * p.half + 1);
    let at = p.center + vec2i(i32(i % side), i32(i / side)) - p.half;
    if any(at < vec2i(0)) || any(at >= vec2i(layer.size)) {
        return -1;
    }
    return at.y * i32(layer.size.x) + at.x;
}

fn is_of_object(p: Part, pixel: i32) -> bool {
    let width = i32(layer.size.x);
    return textureLoad(objects, vec2i(pixel % width, pixel / width), 0).x == p.object;
}

// The rank on a pixel: a fresh sample is exact on its own, and a warped one there above what others paint.
fn rank_at(p: Part, i: u32) -> u32 {
    let side = u32(2 * p.half + 1);
    if i != (side * side) / 2u || p.rank <= APPROXIMATED {
        return p.rank;
    }
    return select(p.rank | layer.own, EXACT, p.tile != NO_TILE);
}

@compute @workgroup_size(64)
fn raise(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= group.count {
        return;
    }
    let p = part(group.first + id.x, id.y);
    for (var i = p.first; i < p.end; i++) {
        let at = pixel(p, i);
        if at >= 0 && is_of_object(p, at) {
            atomicMax(&ranks[at], rank_at(p, i));
        }
    }
}

@compute @workgroup_size(64)
fn own(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= group.count {
        return;
    }
    let p = part(group.first + id.x, id.y);
    for (var i = p.first; i < p.end; i++) {
        let at = pixel(p, i);
        if at >= 0 && atomicLoad(&ranks[at]) == rank_at(p, i) && is_of_object(p, at) {
            atomicMax(&owners[at], splats[group.first + id.x].number);
        }
    }
}

@compute @workgroup_size(64)
fn color(@builtin(global_invocation_id) id: vec3u) {
    if id.x >= group.count {
        return;
    }
    let splat = group.first + id.x;
    let p = part(splat, id.y);
    for (var i = p.first; i < p.end; i++) {
        let at = pixel(p, i);
        if at >= 0 && atomicLoad(&owners[at]) == splats[splat].number && is_of_object(p, at) {
            colors[at] = splats[splat].color;
            details[at] = vec4u(splats[splat].place, splats[splat].guide, 0u);
        }
    }
}
