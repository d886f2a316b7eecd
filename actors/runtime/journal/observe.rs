//! What an observer sees.

use std::sync::Arc;

use crate::message::ActorId;
use crate::message::content::Content;

/// A delivery as an observer sees it, before the actor handles it.
pub struct Delivery<'a> {
    /// Who receives.
    pub actor: ActorId,
    /// Its number among the receiver's deliveries, from 0.
    pub index: u64,
    /// Who sent it; the receiver itself for timers, orders and jobs.
    pub from: ActorId,
    /// The variant's name, or what else was delivered.
    pub kind: &'static str,
    /// In replay: the delivery during which it was sent, pushed or started, by its actor and number. None for what
    /// comes from outside or was sent at the start.
    pub cause: Option<(ActorId, u64)>,
    /// The message (`Actor::Msg`) or job, for an observer that knows the type; a unit where there is neither.
    pub content: &'a dyn std::any::Any,
    /// The receiver as it is before, for an observer that knows its type; a unit where nothing is delivered to it.
    pub receiver: &'a dyn std::any::Any,
    /// What `content` says, made when it is called.
    pub told: &'a dyn Fn() -> Content,
    /// The receiver's state before it, made when it is called.
    pub state: &'a dyn Fn() -> Content,
    /// The receiver's chained hash with this delivery in it; 0 where hashes are off.
    pub chain: u64,
}

/// What an observer may look at of a delivery. Nothing is made where there is no observer.
#[derive(Clone, Copy)]
pub(crate) struct Sight<'a> {
    pub(crate) content: &'a dyn std::any::Any,
    pub(crate) receiver: &'a dyn std::any::Any,
    pub(crate) told: &'a dyn Fn() -> Content,
    pub(crate) state: &'a dyn Fn() -> Content,
}

impl Sight<'_> {
    /// Where neither message nor job is.
    pub(crate) const NOTHING: Self =
        Self { content: &(), receiver: &(), told: &|| Content::Untold, state: &|| Content::Untold };
}

/// Sees every delivery, on the thread that makes it.
pub type Observer = Arc<dyn Fn(&Delivery<'_>) + Send + Sync>;
