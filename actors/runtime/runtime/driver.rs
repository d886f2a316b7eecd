//! Who says whose turn it is, where no threads do.

use std::any::Any;

use crate::journal::faults::Faults;
use crate::runtime::{Exit, Limit, Runtime};
use crate::scheduler::clock::Clock;
use crate::scheduler::link::Class;

/// Makes the turns of a system on one thread, in an order and a time of its own.
pub(crate) trait Driver: Any {
    /// The clock that the system goes by.
    fn clock(&self) -> Clock;
    /// What is to go wrong in it.
    fn faults(&self) -> Faults;
    /// These are its actors; none stands for a port.
    fn meet(&mut self, classes: &[Option<Class>]);
    /// Makes turns until `limit`, or until `condition` holds.
    fn drive(
        &mut self,
        runtime: &mut Runtime,
        limit: Limit,
        end: Option<u64>,
        condition: &mut dyn FnMut(&Runtime) -> bool,
    ) -> Exit;
}
