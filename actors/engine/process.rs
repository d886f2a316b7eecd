//! What this process takes: processor time, which what else the machine does hardly changes, and memory.

use std::time::Instant;

/// Does a part of a start and says how long it took, to whoever asks for such messages (`foveal -vv`).
pub(crate) fn told<R>(part: &str, work: impl FnOnce() -> R) -> R {
    let start = Instant::now();
    let result = work();
    tracing::debug!("{part}: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    result
}

/// Processor time of all threads so far, nanoseconds.
#[cfg(unix)]
pub fn cpu_ns() -> f64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
    time.tv_sec as f64 * 1e9 + time.tv_nsec as f64
}

/// Unknown here.
#[cfg(not(unix))]
pub fn cpu_ns() -> f64 {
    f64::NAN
}

/// Largest resident memory of this process so far, bytes; `None` where the system does not tell.
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok().map(|k| k * 1024)
}

/// Resident memory of this process now, bytes; `None` where the system does not tell.
pub fn memory_bytes() -> Option<u64> {
    Some(memory_stats::memory_stats()?.physical_mem as u64)
}
