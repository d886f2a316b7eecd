//! What an observer sees.

use std::sync::Arc;

use crate::message::ActorId;

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
    /// The receiver's chained hash with this delivery in it; 0 where hashes are off.
    pub chain: u64,
}

/// Sees every delivery, on the thread that makes it.
pub type Observer = Arc<dyn Fn(&Delivery<'_>) + Send + Sync>;
