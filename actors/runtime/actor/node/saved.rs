//! What waits for an actor, as a snapshot holds it.

use std::collections::BTreeMap;

use crate::actor::{Actor, OwnTimer};
use crate::message::saved::{Loader, Saver};
use crate::message::{ActorId, Message};

/// Saves an actor's messages that wait: each with its way and the deliveries to its sender by then.
pub(super) fn save_messages<M: Message>(saver: &mut Saver, messages: &[(ActorId, u8, u64, &M)]) {
    saver.put(&(messages.len() as u64));
    for (from, lane, sent_in, message) in messages {
        saver.put(&(*from, *lane, *sent_in));
        message.save(saver);
    }
}

pub(super) fn load_messages<M: Message>(loader: &mut Loader<'_>) -> Option<Vec<(ActorId, u8, u64, M)>> {
    let count: u64 = loader.take()?;
    let mut messages = Vec::new();
    for _ in 0..count {
        let (from, lane, sent_in) = loader.take()?;
        messages.push((from, lane, sent_in, M::restore(loader)?));
    }
    Some(messages)
}

/// Saves an actor's timers.
pub(super) fn save_timers<A: Actor>(saver: &mut Saver, running: &BTreeMap<u32, OwnTimer<A::Msg>>) {
    saver.put(&(running.len() as u64));
    for (timer, OwnTimer { message, started_in }) in running {
        saver.put(&(*timer, *started_in, message.is_some()));
        if let Some(message) = message {
            message.save(saver);
        }
    }
}

pub(super) fn load_timers<A: Actor>(loader: &mut Loader<'_>) -> Option<BTreeMap<u32, OwnTimer<A::Msg>>> {
    let count: u64 = loader.take()?;
    let mut running = BTreeMap::new();
    for _ in 0..count {
        let (timer, started_in, carries) = loader.take()?;
        let message = if carries { Some(A::Msg::restore(loader)?) } else { None };
        running.insert(timer, OwnTimer { message, started_in });
    }
    Some(running)
}
