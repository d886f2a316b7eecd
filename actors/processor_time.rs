//! The processor time of this program, which what else the machine does hardly changes.

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
