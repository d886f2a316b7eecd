//! Threads that give way: what works ahead must not make those wait that show something now.

/// How much less of a processor a thread gets than one that does not give way, in steps of the system's scale: about half as
/// much where both want the same one, and all of it where it is alone. More steps would leave tracers little beside other
/// programs.
#[cfg(target_os = "linux")]
const STEPS: i32 = 3;

/// From now on the calling thread, and those that it starts, get a processor where others leave one. To be said once by a
/// thread.
///
/// Only Linux can say so of one thread; elsewhere nothing changes.
pub fn give_way() {
    #[cfg(target_os = "linux")]
    if let Err(e) = rustix::process::nice(STEPS) {
        tracing::debug!("a thread cannot give way: {e}");
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn steps() -> i32 {
        rustix::process::getpriority_process(None).expect("the system knows")
    }

    #[test]
    fn a_thread_gives_way_with_those_it_starts_and_no_other() {
        let before = steps();
        let after = std::thread::spawn(|| {
            give_way();
            [steps(), std::thread::spawn(steps).join().expect("it ends")]
        });
        // 19 is the end of the scale.
        assert_eq!(after.join().expect("it ends"), [(before + STEPS).min(19); 2]);
        assert_eq!(steps(), before);
    }
}
