//! Debug information, which backtraces take their lines from, is more than half of the program: it is compressed.

fn main() {
    println!("cargo:rerun-if-changed=build.rs");
    // Optimised builds alone: others are linked often and kept by nobody.
    let of = |name: &str| std::env::var(name).unwrap_or_default();
    if of("CARGO_CFG_TARGET_OS") == "linux" && of("PROFILE") == "release" {
        println!("cargo:rustc-link-arg-bins=-Wl,--compress-debug-sections=zlib");
    }
}
