//! Making the actors of a system and their connections.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::actor::node::{AnyNode, Node};
use crate::actor::reserve::Reserve;
use crate::actor::seat::Seat;
use crate::actor::supervise::OnPanic;
use crate::actor::{Actor, Handle, post};
use crate::journal::Journal;
use crate::journal::env::Env;
use crate::journal::port::{External, Port};
use crate::log::format::NodeInfo;
use crate::mailbox::{Address, Bounds, Mailbox};
use crate::message::incident::Incident;
use crate::message::{ActorId, Message, Reason, Rejected};
use crate::pool::{AnyPool, DeadJob, Job, JobPool, Worker};
use crate::scheduler::link::{Class, Link};
use crate::scheduler::{Runnable, ThreadCx};

/// An address whose actor is still to come.
pub struct Declared<A: Actor> {
    address: Address<A::Msg>,
}

impl<A: Actor> Declared<A> {
    /// Where the actor will be reached.
    pub fn address(&self) -> Address<A::Msg> {
        self.address.clone()
    }
}

/// Makes the actors of a system and their connections. The order of the calls is the actors' identity, so the same
/// wiring must run for a recording and its replay.
pub struct Wiring {
    env: Arc<Env>,
    pub(crate) infos: Vec<NodeInfo>,
    pub(crate) links: Vec<Option<Arc<Link>>>,
    pub(crate) nodes: Vec<Option<Arc<dyn AnyNode>>>,
    pub(crate) pools: Vec<Box<dyn AnyPool>>,
    pub(crate) context: Option<Arc<dyn Any + Send + Sync>>,
    ring_turns: usize,
}

impl Wiring {
    pub(crate) fn new(env: &Arc<Env>, ring_turns: usize) -> Self {
        let (infos, links, nodes, pools) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        Self { env: Arc::clone(env), infos, links, nodes, pools, context: None, ring_turns }
    }

    fn node(&mut self, name: &str, class: Option<Class>) -> ActorId {
        let same = self.infos.iter().filter(|info| info.name.split('-').next() == Some(name)).count();
        let name = if same == 0 { name.to_owned() } else { format!("{name}-{}", same + 1) };
        self.infos.push(NodeInfo { name, class });
        self.links.push(None);
        self.nodes.push(None);
        ActorId(self.infos.len() as u32 - 1)
    }

    /// Makes the mailbox of an actor, so that others can be given its address; [`Wiring::spawn`] gives it the actor.
    pub fn declare<A: Actor>(&mut self, bounds: Bounds) -> Declared<A> {
        let id = self.node(A::NAME, Some(A::CLASS));
        let name = self.infos[id.0 as usize].name.clone();
        let link = Arc::new(Link::new(id, name, A::CLASS, self.ring_turns, &self.env.scheduler));
        self.links[id.0 as usize] = Some(Arc::clone(&link));
        Declared { address: Address { mailbox: Arc::new(Mailbox::new(link, bounds)) } }
    }

    /// Gives a declared mailbox its actor, and says what becomes of it when it panics.
    pub fn spawn<A: Actor>(&mut self, declared: Declared<A>, actor: A, on_panic: OnPanic<A>) -> Handle<A> {
        self.seat(declared, actor, on_panic, None)
    }

    /// Gives a declared mailbox a worker, which takes jobs from `pool` whenever its mailbox is empty.
    pub fn spawn_worker<A: Worker>(
        &mut self,
        declared: Declared<A>,
        actor: A,
        pool: &JobPool<A::Job>,
        on_panic: OnPanic<A>,
    ) -> Handle<A> {
        let seat = pool.sit::<A>(&declared.address.mailbox.link);
        self.seat(declared, actor, on_panic, Some(seat))
    }

    fn seat<A: Actor>(
        &mut self,
        declared: Declared<A>,
        actor: A,
        on_panic: OnPanic<A>,
        seat: Option<Box<dyn Seat<A>>>,
    ) -> Handle<A> {
        let id = declared.address.id();
        self.nodes[id.0 as usize] =
            Some(Arc::new(Node::new(&declared.address, Some(actor), on_panic, seat, &self.env)));
        Handle::new(id)
    }

    /// Reserves places for `count` actors that come while the system runs: see [`Cx::spawn`](crate::Cx::spawn).
    pub fn reserve<A: Actor>(&mut self, count: usize, bounds: Bounds) -> Reserve<A> {
        let places = (0..count).map(|_| {
            let address = self.declare::<A>(bounds).address;
            let node = Arc::new(Node::new(&address, None, OnPanic::Stop, None, &self.env));
            self.nodes[address.id().0 as usize] = Some(Arc::clone(&node) as Arc<dyn AnyNode>);
            node
        });
        Reserve::new(places.collect())
    }

    /// Makes an ingress from outside to an actor.
    pub fn port<E: External<M>, M: Message>(&mut self, name: &str, to: &Address<M>) -> Port<E, M> {
        let id = self.node(name, None);
        Port::new(id, to, &self.env)
    }

    /// What actors and messages need to be read back from a snapshot beside what was saved: see
    /// [`crate::Loader::context`].
    pub fn context<T: Any + Send + Sync>(&mut self, context: T) {
        self.context = Some(Arc::new(context));
    }

    /// Makes a pool for at most `capacity` waiting jobs.
    pub fn pool<J: Job>(&mut self, capacity: usize) -> JobPool<J> {
        let pool = JobPool::new(&self.env, capacity);
        self.pools.push(Box::new(pool.clone()));
        pool
    }

    /// Lends the jobs of `pool` for `time`: a worker that has not come to the end by then loses the job to another one,
    /// and [`crate::Cx::claim`] tells it so. Looked after by any thread of the system that is not in a turn, so with at
    /// least two worker threads; not in replay, which knows. Choose much more than a job takes: one that is only slow is
    /// done twice. Later calls change nothing.
    pub fn leases<J: Job>(&mut self, pool: &JobPool<J>, time: Duration) {
        pool.lease(time);
    }

    /// Says who is told of jobs of `pool` that are given up, and how that actor puts it. Later calls change nothing.
    /// Choose [`crate::Lane::Control`] for the message: where it finds no room, the system ends.
    pub fn gives_up<J: Job, M: Message>(
        &mut self,
        pool: &JobPool<J>,
        to: &Address<M>,
        message: impl Fn(DeadJob<J::Brief>) -> M + Send + Sync + 'static,
    ) {
        let tell = teller(to, message);
        pool.bury_with(Box::new(tell));
    }

    /// Says who is told of panics and stopped actors, and how that actor puts it. One supervisor a system;
    /// later calls change nothing. Choose [`crate::Lane::Control`] for the message, so that it gets through: where it
    /// does not, the system ends ([`crate::Exit::Ended`]), since somebody may wait for what the supervisor would do.
    pub fn supervisor<M: Message>(
        &mut self,
        to: &Address<M>,
        message: impl Fn(Incident) -> M + Send + Sync + 'static,
    ) {
        let _ = self.env.supervisor.set(Box::new(teller(to, message)));
    }
}

/// Tells `to` on behalf of the actor whose journal it is given; false if there is no room.
fn teller<T, M: Message>(
    to: &Address<M>,
    message: impl Fn(T) -> M + Send + Sync + 'static,
) -> impl Fn(&mut Journal, &ThreadCx, T) -> bool + Send + Sync + 'static {
    // Weak: the system's shared part would own a mailbox that owns it.
    let to = Arc::downgrade(&to.mailbox);
    move |journal, thread, what| {
        let Some(mailbox) = to.upgrade() else { return true };
        let told = post(journal, thread, &Address { mailbox }, message(what));
        // One that has stopped waits for nothing.
        !matches!(told, Err(Rejected { reason: Reason::Full | Reason::FullBytes, .. }))
    }
}

/// Stands where a port's number is among the actors'.
pub(crate) struct PortNode {
    link: Arc<Link>,
}

impl PortNode {
    pub(crate) fn new(env: &Arc<Env>) -> Self {
        let link = Link::new(ActorId(u32::MAX), String::new(), Class::Light, 1, &env.scheduler);
        link.closed.store(true, Ordering::Relaxed);
        Self { link: Arc::new(link) }
    }
}

impl Runnable for PortNode {
    fn turn(&self, _thread: &ThreadCx) -> bool {
        false
    }

    fn link(&self) -> &Arc<Link> {
        &self.link
    }
}

impl AnyNode for PortNode {}
