//! The machine that a result was made on.

use serde_json::json;
use sysinfo::{CpuRefreshKind, RefreshKind, System};

/// Vector instructions that this processor has and the program knows of.
pub fn simd() -> Vec<&'static str> {
    #[cfg(target_arch = "x86_64")]
    {
        let mut found = vec!["sse2"];
        for (name, there) in [
            ("sse4.1", std::arch::is_x86_feature_detected!("sse4.1")),
            ("avx2", std::arch::is_x86_feature_detected!("avx2")),
            ("fma", std::arch::is_x86_feature_detected!("fma")),
            ("avx512f", std::arch::is_x86_feature_detected!("avx512f")),
        ] {
            if there {
                found.push(name);
            }
        }
        found
    }
    #[cfg(target_arch = "aarch64")]
    {
        vec!["neon"]
    }
    #[cfg(not(any(target_arch = "x86_64", target_arch = "aarch64")))]
    {
        Vec::new()
    }
}

/// Name of the processor, where the system tells.
pub fn processor() -> Option<String> {
    let only_names = RefreshKind::nothing().with_cpu(CpuRefreshKind::nothing());
    let name = System::new_with_specifics(only_names).ok()?.cpus().first()?.brand().trim().to_owned();
    Some(name).filter(|name| !name.is_empty())
}

/// The machine, as reports and benchmarks name it.
pub fn machine() -> serde_json::Value {
    json!({
        "processor": processor(),
        "cores": std::thread::available_parallelism().map_or(1, usize::from),
        "simd": simd(),
        "os": std::env::consts::OS,
        "version": env!("CARGO_PKG_VERSION"),
    })
}
