//! Hands the compiler's version and the target to the crate: both are part of a recording's determinism domain.

fn main() {
    println!("cargo::rustc-check-cfg=cfg(loom)");
    println!("cargo::rerun-if-changed=build.rs");
    let rustc = std::env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let version = std::process::Command::new(rustc)
        .arg("--version")
        .output()
        .ok()
        .and_then(|output| String::from_utf8(output.stdout).ok())
        .unwrap_or_default();
    println!("cargo::rustc-env=FOVEAL_COMPILER={}", version.trim());
    println!("cargo::rustc-env=FOVEAL_TARGET={}", std::env::var("TARGET").unwrap_or_default());
}
