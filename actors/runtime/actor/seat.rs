//! A worker's place at a pool, as the worker knows it: whatever the jobs are, and wherever they come from.

use std::any::Any;

use crate::actor::{Actor, Cx};
use crate::journal::Journal;
use crate::log::format::{Symbol, lane};
use crate::message::Digest;
use crate::message::content::Content;
use crate::message::saved::{Loader, Saver};
use crate::scheduler::ThreadCx;

/// A job that so many workers did not survive, or did not come to the end of, is given up.
pub const KILLS_MAX: u32 = 3;

/// What a seat popped.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Popped {
    pub(crate) id: u64,
    pub(crate) attempt: u32,
    pub(crate) pushed_in: u64,
    pub(crate) stale: bool,
}

/// A worker's side of its pool, whatever the jobs are.
pub(crate) trait Seat<A: Actor>: Send {
    /// Pops the best job for this actor, if it takes one, and holds it.
    fn pop(&mut self, actor: &A, thread: &ThreadCx) -> Option<Popped>;
    /// Replay: holds this job and tells when it was pushed; none if it was not yet.
    fn hold(&mut self, id: u64, attempt: u32) -> Option<u64>;
    fn digest(&self, digest: &mut Digest);
    fn kind(&self) -> &'static str;
    fn content(&self) -> &dyn Any;
    fn told(&self) -> Content;
    fn run(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>);
    fn stale(&mut self, actor: &mut A, cx: &mut Cx<'_, A::Msg>);
    /// The job is done with.
    fn completed(&mut self, journal: &mut Journal);
    /// Simulation: the worker hangs at the job it holds until that is somebody else's.
    fn hang(&self, thread: &ThreadCx);
    /// Nobody came to the end of the job: it is given up.
    fn give_up(&mut self, journal: &mut Journal, thread: &ThreadCx);
    /// The job panicked with this: it goes back, or is given up.
    fn killed(&mut self, journal: &mut Journal, thread: &ThreadCx, message: &str);
    /// Waits for jobs, if the actor takes any; false if one is there already.
    fn rest(&self, actor: &A) -> bool;
    /// Takes no jobs for now; somebody else is told of one that waits.
    fn decline(&self, thread: &ThreadCx);
    /// Leaves for good unless nobody else is left.
    fn leave(&self, thread: &ThreadCx) -> bool;
    fn leave_regardless(&self, thread: &ThreadCx);
    /// Writes the jobs that wait for the script of a replay to call for them.
    fn save(&mut self, saver: &mut Saver);
    fn restore(&mut self, loader: &mut Loader<'_>) -> Option<()>;
}

/// What a worker's code can ask of its job, whatever kind it is.
pub(crate) trait Lease: Send + Sync {
    /// Whether the job at hand is still this worker's; the first answer holds for the whole delivery.
    fn claim(&self, journal: &mut Journal) -> bool;
    /// Whether its epoch has not passed, by now.
    fn is_wanted(&self) -> bool;
    /// Says that the job is not over with this delivery; its identity and attempt.
    fn keep(&self) -> (u64, u32);
}

/// The journal's part in a pop.
pub(crate) fn job_symbol(journal: &Journal, popped: &Popped) -> Symbol {
    let lane = match (popped.stale, popped.attempt) {
        (false, 0) => lane::JOB,
        (false, _) => lane::JOB_AGAIN,
        (true, 0) => lane::STALE,
        (true, _) => lane::STALE_AGAIN,
    };
    Symbol { from: journal.id, lane }
}
