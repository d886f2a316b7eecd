//! Threads that give way, since what works ahead must not make those wait that show something now, and threads that are prompt.

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
    // What works ahead is done sooner where it is interrupted less often.
    be_patient();
}

/// From now on the calling thread, and those that it starts, ask for a processor's time in short slices: no more of it than
/// others, but sooner. Where another program's loop holds a processor, a phase of all threads would else wait for a slice of
/// it, each time one of them has been interrupted.
///
/// Linux does so from 6.12 on, which schedules by deadlines (EEVDF): a short slice's deadline is near. Elsewhere, and
/// where the user has chosen another policy, nothing changes.
pub fn be_prompt() {
    #[cfg(target_os = "linux")]
    slices::ask_for(slices::SHORT);
}

/// The calling thread, and those that it starts, are not prompt any more.
pub fn be_patient() {
    #[cfg(target_os = "linux")]
    slices::ask_for(slices::USUAL);
}

#[cfg(target_os = "linux")]
mod slices {
    use std::io;

    /// Nanoseconds: the least that the system grants.
    pub(super) const SHORT: u64 = 100_000;
    /// What the system gives who asks for none, 0.7 ms on one processor to 2.8 ms on many.
    pub(super) const USUAL: u64 = 0;

    /// Sets the calling thread's slice, and that of threads it starts later.
    pub(super) fn ask_for(nanoseconds: u64) {
        match set(nanoseconds) {
            Ok(()) => {}
            Err(e) => tracing::debug!("a thread has the slices it had: {e}"),
        }
    }

    #[expect(unsafe_code, reason = "system calls that no crate wraps")]
    fn set(nanoseconds: u64) -> io::Result<()> {
        let told = |result: libc::c_long| if result == 0 { Ok(()) } else { Err(io::Error::last_os_error()) };
        let size = size_of::<libc::sched_attr>() as u32;
        let mut of = libc::sched_attr {
            size,
            sched_policy: 0,
            sched_flags: 0,
            sched_nice: 0,
            sched_priority: 0,
            sched_runtime: 0,
            sched_deadline: 0,
            sched_period: 0,
        };
        // SAFETY: 0 is the calling thread; the system writes at most `size` bytes to `of`, which outlives the call.
        told(unsafe { libc::syscall(libc::SYS_sched_getattr, 0, &raw mut of, size, 0) })?;
        if of.sched_policy != libc::SCHED_OTHER as u32 {
            return Ok(());
        }
        of.sched_runtime = nanoseconds;
        // SAFETY: as above; the system only reads.
        told(unsafe { libc::syscall(libc::SYS_sched_setattr, 0, &raw const of, 0) })
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn steps() -> i32 {
        rustix::process::getpriority_process(None).expect("the system knows")
    }

    /// Of the calling thread, where the system tells and grants it.
    fn slice() -> Option<u64> {
        let told = std::fs::read_to_string("/proc/thread-self/sched").ok()?;
        let line = told.lines().find(|line| line.starts_with("se.slice"))?;
        line.rsplit(' ').next()?.parse().ok()
    }

    #[test]
    fn a_prompt_thread_and_those_it_starts_have_short_slices_until_they_give_way() {
        let before = slice();
        let after = std::thread::spawn(|| {
            be_prompt();
            let began = std::thread::spawn(slice).join().expect("it ends");
            let late = std::thread::spawn(|| (give_way(), slice()).1).join().expect("it ends");
            [slice(), began, late]
        });
        let [prompt, began, late] = after.join().expect("it ends");
        assert_eq!(slice(), before, "no other");
        // Systems that grant no slices, or do not tell them, leave all as it was.
        let Some(usual) = before.filter(|&before| prompt.is_some_and(|prompt| prompt < before)) else {
            assert_eq!([prompt, began, late], [before; 3]);
            return;
        };
        assert_eq!((prompt, began), (Some(slices::SHORT), prompt));
        assert_eq!(late, Some(usual));
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
