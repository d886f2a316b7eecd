//! The machine that a result was made on, and when.

use std::time::SystemTime;

use serde_json::{Value, json};
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

/// What tells processors of one name apart, where the system says: on virtual machines the name alone says little.
fn processor_id() -> Option<String> {
    let told = std::fs::read_to_string("/proc/cpuinfo").ok()?;
    let of = |key: &str| {
        let line = told.lines().find_map(|line| line.strip_prefix(key)?.trim_start().strip_prefix(':'))?;
        Some(line.trim().to_owned())
    };
    Some(format!("family {}, model {}, stepping {}", of("cpu family")?, of("model\t")?, of("stepping")?))
}

/// The machine, as reports and benchmarks name it.
pub fn machine() -> Value {
    json!({
        "processor": processor(),
        "processor_id": processor_id(),
        "cores": std::thread::available_parallelism().map_or(1, usize::from),
        "simd": simd(),
        "os": std::env::consts::OS,
        "os_version": System::long_os_version().ok(),
        "kernel": System::kernel_version().ok(),
        "version": env!("CARGO_PKG_VERSION"),
    })
}

/// The day, as `2001-12-31`.
#[expect(clippy::disallowed_methods, reason = "outside of the actors: a report is dated")]
pub fn today() -> String {
    let now = humantime::format_rfc3339_seconds(SystemTime::now()).to_string();
    now.split('T').next().unwrap_or_default().to_owned()
}

/// By which version, on which machine and when a document was made, in words; what it does not say is left out.
pub fn made_on(document: &Value) -> String {
    let m = &document["machine"];
    let text = |key: &str| m[key].as_str().map(str::to_owned);
    let simd: Vec<&str> = m["simd"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
    let processor = text("processor").unwrap_or_else(|| "an unknown processor".into());
    let processor = match text("processor_id") {
        Some(id) => format!("{processor} ({id})"),
        None => processor,
    };
    let cores = m["cores"].as_u64().map(|n| format!("{n} {}", if n == 1 { "core" } else { "cores" }));
    let parts = [
        Some(processor),
        cores,
        (!simd.is_empty()).then(|| simd.join(" ")),
        text("os_version").or_else(|| text("os")),
        text("kernel").map(|kernel| format!("kernel {kernel}")),
        document["date"].as_str().map(str::to_owned),
    ];
    let parts: Vec<String> = parts.into_iter().flatten().collect();
    format!("foveal {} on {}", text("version").unwrap_or_default(), parts.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_document_says_where_and_when_it_was_made() {
        let machine = json!({"processor": "P", "processor_id": "family 1", "cores": 1, "simd": ["a", "b"], "os": "o",
            "os_version": "O 1", "kernel": "2", "version": "0.1"});
        let words = made_on(&json!({"machine": machine, "date": "2001-12-31"}));
        assert_eq!(words, "foveal 0.1 on P (family 1), 1 core, a b, O 1, kernel 2, 2001-12-31");
        let older = json!({"machine": {"processor": "P", "cores": 2, "os": "o", "version": "0.1"}});
        assert_eq!(made_on(&older), "foveal 0.1 on P, 2 cores, o");
    }

    #[test]
    fn this_machine_is_named() {
        let here = machine();
        assert!(here["os"].is_string() && here["cores"].as_u64() >= Some(1), "{here}");
        if cfg!(all(target_os = "linux", target_arch = "x86_64")) {
            assert!(here["processor_id"].as_str().is_some_and(|id| id.starts_with("family ")), "{here}");
        }
        let day = today();
        assert!(day.len() == 10 && day.matches('-').count() == 2, "{day}");
    }
}
