//! Rays, watertight triangles and the BVH.
