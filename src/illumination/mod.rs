//! View-independent diffuse illumination: atlas, density estimation, cache.
