//! Tracers on other machines: the door through which they come to a walk, and what runs on them.
//!
//! ```text
//!     RENDERER, ALLOCATOR, CACHE AGER …                           other machines
//!         ^ SamplesTraced, JobDone                        ┌─────── foveal trace
//!         │                                               │  guest: stock, world, one thread a core
//!     STATION 1 … k <── Heard ─── door (a thread) <─ link ┤
//!                   ─── ToGuest ─>                        └─────── …
//! ```
//!
//! | module | what |
//! | --- | --- |
//! | [`key`] | who may come: a key, and where to |
//! | [`package`] | a scene with its light as blobs, named by their content |
//! | [`link`], [`quic`], [`tcp`] | bytes from one machine to another |
//! | [`identity`] | how an encrypted link knows either side by the key |
//! | [`door`] | the walk's side: who comes, what they are sent, what they say |
//! | [`hands`] | a reference or a bake in pieces, which guests do as well |
//! | [`guest`], [`work`], [`ground`] | the other side |
//!
//! A walk decides by its [stations](foveal_actors::station); the door decides only who may come. Both sides take the other
//! one for hostile: messages are bounded and checked ([`foveal_actors::station::wire`]), a guest opens no path that it was
//! told, a walk believes no colour without looking at some.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it serves")]

pub mod door;
mod foreman;
pub mod ground;
pub mod guest;
pub mod hands;
#[cfg(test)]
mod hands_tests;
pub mod identity;
mod inbox;
pub mod key;
pub mod link;
#[cfg(test)]
mod network_tests;
pub mod package;
pub mod quic;
mod round;
pub mod tcp;
#[cfg(test)]
mod tests;
pub mod work;

/// Program and version: only the same trace together.
pub fn program() -> String {
    format!("foveal {} protocol {}", env!("CARGO_PKG_VERSION"), foveal_actors::station::wire::PROTOCOL)
}
