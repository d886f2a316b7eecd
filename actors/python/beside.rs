//! Something that lives on a thread of its own, and is asked from any other.

use std::marker::PhantomData;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::Duration;

use foveal_engine::Failure;
use pyo3::prelude::*;

use crate::failure::{Error, raised};

/// Between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(20);

type Order<T> = Box<dyn FnOnce(&mut T) + Send>;

/// A `T` on a thread of its own; dropped, it ends there, and is waited for.
pub struct Beside<T> {
    /// `None` only while it is dropped.
    orders: Option<Sender<Order<T>>>,
    thread: Option<JoinHandle<()>>,
    what: PhantomData<fn(&mut T)>,
}

/// Whether whoever asked still waits.
#[derive(Clone, Default)]
pub struct Wanted(Arc<AtomicBool>);

impl Wanted {
    /// Whether the answer is still wanted: not after Ctrl-C.
    pub fn is(&self) -> bool {
        !self.0.load(Ordering::Relaxed)
    }
}

impl<T: 'static> Beside<T> {
    /// Makes it on its thread.
    pub fn spawn<M>(py: Python<'_>, make: M) -> PyResult<Self>
    where
        M: FnOnce(&Wanted) -> Result<T, Failure> + Send + 'static,
    {
        let (orders, inbox) = channel::<Order<T>>();
        let (stands, standing) = channel();
        let wanted = Wanted::default();
        let inside = wanted.clone();
        let thread =
            std::thread::Builder::new().name("foveal".into()).spawn(move || match make(&inside) {
                Err(failure) => drop(stands.send(Err(failure))),
                Ok(mut held) => {
                    drop(stands.send(Ok(())));
                    while let Ok(order) = inbox.recv() {
                        order(&mut held);
                    }
                }
            })?;
        answer(py, standing, &wanted)?.map_err(raised)?;
        Ok(Self { orders: Some(orders), thread: Some(thread), what: PhantomData })
    }

    /// Asks, and waits for the answer; other Python threads go on meanwhile.
    pub fn ask<R, O>(&self, py: Python<'_>, order: O) -> PyResult<R>
    where
        R: Send + 'static,
        O: FnOnce(&mut T, &Wanted) -> Result<R, Failure> + Send + 'static,
    {
        let (tells, told) = channel();
        let wanted = Wanted::default();
        let inside = wanted.clone();
        let order: Order<T> = Box::new(move |held| drop(tells.send(order(held, &inside))));
        // Where nobody takes it any more, `told` says so.
        let _ = self.orders.as_ref().map(|orders| orders.send(order));
        answer(py, told, &wanted)?.map_err(raised)
    }
}

impl<T> Drop for Beside<T> {
    fn drop(&mut self) {
        self.orders = None;
        let mut thread = self.thread.take();
        let mut join = || drop(thread.take().map(JoinHandle::join));
        // A recording is to have its end. Where the interpreter ends, there is nobody left to let go on.
        if Python::try_attach(|py| py.detach(&mut join)).is_none() {
            join();
        }
    }
}

/// Does something long on this thread, in which `work` looks whether it is still wanted.
pub fn wait_for<R, W>(py: Python<'_>, work: W) -> PyResult<R>
where
    R: Send + 'static,
    W: FnOnce(&Wanted) -> Result<R, Failure> + Send + 'static,
{
    let (tells, told) = channel();
    let wanted = Wanted::default();
    let inside = wanted.clone();
    std::thread::Builder::new().name("foveal".into()).spawn(move || drop(tells.send(work(&inside))))?;
    answer(py, told, &wanted)?.map_err(raised)
}

fn answer<R: Send>(py: Python<'_>, told: Receiver<R>, wanted: &Wanted) -> PyResult<R> {
    let mut told = told;
    loop {
        // A receiver is nobody's but its owner's: it goes along and comes back.
        let (back, received) = py.detach(move || {
            let received = told.recv_timeout(LOOK);
            (told, received)
        });
        told = back;
        match received {
            Ok(answer) => return Ok(answer),
            Err(RecvTimeoutError::Timeout) => {
                py.check_signals().inspect_err(|_| wanted.0.store(true, Ordering::Relaxed))?;
            }
            Err(RecvTimeoutError::Disconnected) => {
                return Err(Error::new_err(
                    "it has ended: an earlier call failed in a way that nothing can mend",
                ));
            }
        }
    }
}
