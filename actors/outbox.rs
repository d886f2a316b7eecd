//! What was not accepted, kept until it is: in order, behind one timer.
//!
//! Mailboxes and pool hold what credits allow, so live runs hardly ever need this; a simulation that
//! gives messages back does, and nothing is lost there either.

use std::collections::VecDeque;
use std::time::Duration;

use foveal_runtime::{Address, Cx, Job, JobPool, Message, Reason, Rejected};

/// How long a message that came back waits.
const WAIT: Duration = Duration::from_millis(1);

/// Messages and jobs on their way from one actor, oldest first.
pub struct Outbox<M: Message> {
    /// What the actor is told when it is time to try again.
    retry: fn() -> M,
    waiting: VecDeque<Box<dyn Posting<M>>>,
    /// Whether the timer runs.
    asked: bool,
}

/// Something that can be sent.
trait Posting<M: Message>: Send {
    /// Sends it; false if it came back.
    fn post(&mut self, cx: &mut Cx<'_, M>) -> bool;
}

struct Letter<N: Message> {
    to: Address<N>,
    /// `None` once it was accepted.
    message: Option<N>,
}

impl<M: Message, N: Message> Posting<M> for Letter<N> {
    fn post(&mut self, cx: &mut Cx<'_, M>) -> bool {
        let Some(message) = self.message.take() else { return true };
        self.message = cx.tell(&self.to, message).err().and_then(wanted);
        self.message.is_none()
    }
}

/// What came back, if it can ever be accepted: whoever has stopped takes nothing, and must not keep others from theirs.
fn wanted<T>(Rejected { message, reason }: Rejected<T>) -> Option<T> {
    (reason != Reason::Stopped).then_some(message)
}

struct Order<J: Job> {
    pool: JobPool<J>,
    bucket: u8,
    epoch: u64,
    /// `None` once it was accepted.
    job: Option<J>,
}

impl<M: Message, J: Job> Posting<M> for Order<J> {
    fn post(&mut self, cx: &mut Cx<'_, M>) -> bool {
        let Some(job) = self.job.take() else { return true };
        self.job = cx.push(&self.pool, self.bucket, self.epoch, job).err().map(|rejected| rejected.message);
        self.job.is_none()
    }
}

impl<M: Message> Outbox<M> {
    /// An empty outbox of an actor that calls [`Outbox::send`] when it is told `retry()`.
    pub fn new(retry: fn() -> M) -> Self {
        Self { retry, waiting: VecDeque::new(), asked: false }
    }

    /// Tells `to`, after everything that waits.
    pub fn tell<N: Message>(&mut self, cx: &mut Cx<'_, M>, to: &Address<N>, message: N) {
        self.flush(cx);
        let rejected = match self.waiting.is_empty() {
            true => cx.tell(to, message).err().and_then(wanted),
            false => Some(message),
        };
        if rejected.is_some() {
            self.keep(cx, Box::new(Letter { to: to.clone(), message: rejected }));
        }
    }

    /// Pushes a job, after everything that waits.
    pub fn push<J: Job>(&mut self, cx: &mut Cx<'_, M>, pool: &JobPool<J>, bucket: u8, epoch: u64, job: J) {
        self.flush(cx);
        let rejected = match self.waiting.is_empty() {
            true => cx.push(pool, bucket, epoch, job).err().map(|rejected| rejected.message),
            false => Some(job),
        };
        if rejected.is_some() {
            self.keep(cx, Box::new(Order { pool: pool.clone(), bucket, epoch, job: rejected }));
        }
    }

    /// Tries again, now that it is time or that the last try was lost.
    pub fn send(&mut self, cx: &mut Cx<'_, M>) {
        self.asked = false;
        self.flush(cx);
        if !self.waiting.is_empty() {
            self.ask(cx);
        }
    }

    /// Number of messages and jobs that wait.
    ///
    /// Credits bound them: jobs in flight and their answers, one drop of textures at a time. What is sent for every frame is
    /// of the newest-only kind, which a full mailbox does not give back.
    pub fn len(&self) -> usize {
        self.waiting.len()
    }

    /// Whether nothing waits.
    pub fn is_empty(&self) -> bool {
        self.waiting.is_empty()
    }

    fn flush(&mut self, cx: &mut Cx<'_, M>) {
        while self.waiting.front_mut().is_some_and(|first| first.post(cx)) {
            self.waiting.pop_front();
        }
    }

    fn keep(&mut self, cx: &mut Cx<'_, M>, posting: Box<dyn Posting<M>>) {
        self.waiting.push_back(posting);
        self.ask(cx);
    }

    fn ask(&mut self, cx: &mut Cx<'_, M>) {
        self.asked = self.asked || cx.after(WAIT, (self.retry)()).is_ok();
    }
}
