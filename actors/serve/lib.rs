//! A walk in the browser: a server with one page, and a WebSocket between that and a walk.
//!
//! In: a walk on a thread of its own ([`foveal_engine::thread`]), and whatever comes by the network. Out: pictures, to whoever
//! has the token. What hands do in a page becomes the acts that the window makes of keys and mouse, with their times; so a
//! walk in the browser is recorded and replayed like any other.
//!
//! | module | what |
//! | --- | --- |
//! | [`server`] | sockets: connections in, their messages to the hub, its effects out |
//! | [`hub`], [`room`], [`viewer`] | who looks, who drives, who is sent what: a state machine without sockets |
//! | [`protocol`], [`report`], [`scales`] | messages |
//! | [`coding`], [`flow`] | pictures as bytes, and how many of them |
//! | [`gate`] | hosts, origins, tokens |
//! | [`page`] | what the browser shows |
//!
//! What comes from outside is parsed in [`protocol`], bounded in length, rate and number, and never trusted with an index.

#![expect(clippy::disallowed_methods, reason = "outside of the actors, which it drives")]

pub mod coding;
pub mod flow;
pub mod gate;
pub mod hub;
pub mod page;
pub mod protocol;
pub mod report;
pub mod room;
pub mod scales;
pub mod server;
pub mod viewer;
