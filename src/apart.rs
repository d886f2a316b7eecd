//! Work in threads of its own, for what is looked for once while others wait for it.
//!
//! Who waits in a thread of rayon takes on other work meanwhile. Where that asks for the very thing that is being looked for, the
//! thread waits for itself; so what stands in a `OnceLock` that such work reads is not looked for with rayon.

use std::ops::Range;
use std::panic::resume_unwind;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Items for which another thread is worth its start.
const LEAST: usize = 256;
/// Parts for each thread: some take longer than others.
const PARTS: usize = 8;

/// What `of` makes of parts of `0..count`, one after the other; as many threads as rayon has.
pub fn in_parts<T: Send>(count: usize, of: impl Fn(Range<usize>) -> Vec<T> + Sync) -> Vec<T> {
    let threads = rayon::current_num_threads().min(count / LEAST);
    if threads < 2 {
        return of(0..count);
    }
    let (parts, next) = (PARTS * threads, AtomicUsize::new(0));
    let work = || {
        let mut done = Vec::new();
        loop {
            let part = next.fetch_add(1, Ordering::Relaxed);
            if part >= parts {
                return done;
            }
            done.push((part, of(part * count / parts..(part + 1) * count / parts)));
        }
    };
    let mut done = std::thread::scope(|scope| {
        let others: Vec<_> = (1..threads).map(|_| scope.spawn(work)).collect();
        let own = work();
        let others =
            others.into_iter().map(|other| other.join().unwrap_or_else(|panic| resume_unwind(panic)));
        others.fold(own, |mut all, of_other| {
            all.extend(of_other);
            all
        })
    });
    done.sort_unstable_by_key(|(part, _)| *part);
    done.into_iter().flat_map(|(_, part)| part).collect()
}

#[cfg(test)]
mod tests {
    use rayon::prelude::*;
    use std::sync::OnceLock;

    use super::*;

    #[test]
    fn everything_is_done_once_and_in_order() {
        for count in [0, 1, LEAST, 2 * LEAST - 1, 2 * LEAST, 10_007] {
            let all = in_parts(count, |part| part.map(|i| i * i).collect());
            assert!(all.iter().copied().eq((0..count).map(|i| i * i)), "{count}");
        }
    }

    /// With rayon inside, one of these would wait for itself.
    #[test]
    fn who_waits_in_a_pool_of_threads_is_not_kept_waiting() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(4).build().expect("a pool");
        let sum = OnceLock::new();
        let look = || in_parts(100_000, |part| part.map(|i| i as u64).collect()).iter().sum::<u64>();
        let seen: u64 = pool.install(|| (0..64u64).into_par_iter().map(|_| *sum.get_or_init(look)).sum());
        assert_eq!(seen, 64 * (100_000 * 99_999 / 2));
    }
}
