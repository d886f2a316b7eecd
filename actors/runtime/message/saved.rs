//! How a state is written for a snapshot, and read back.

use serde::Serialize;
use serde::de::DeserializeOwned;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Writes the state of an actor, a message or a job.
#[derive(Default)]
pub struct Saver {
    bytes: Vec<u8>,
    context: Option<Arc<dyn Any + Send + Sync>>,
    /// Shared values by their place in memory, which nothing else can take while they are held.
    numbers: BTreeMap<usize, u32>,
    held: Vec<Arc<dyn Any + Send + Sync>>,
    refused: bool,
}

impl Saver {
    pub(crate) fn new(context: Option<Arc<dyn Any + Send + Sync>>) -> Self {
        Self { context, ..Self::default() }
    }

    /// What the wiring gave to [`crate::Wiring::context`].
    pub fn context<T: Any + Send + Sync>(&self) -> Option<Arc<T>> {
        self.context.clone()?.downcast().ok()
    }

    /// Writes a value.
    pub fn put(&mut self, value: &(impl Serialize + ?Sized)) {
        match postcard::to_extend(value, std::mem::take(&mut self.bytes)) {
            Ok(bytes) => self.bytes = bytes,
            Err(_) => self.refused = true,
        }
    }

    /// Writes bytes with their length.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.put(&bytes.len());
        self.bytes.extend_from_slice(bytes);
    }

    /// Writes a value that several own: once, and its number wherever it comes again.
    pub fn shared<T: Any + Send + Sync>(&mut self, value: &Arc<T>, save: impl FnOnce(&T, &mut Self)) {
        let place = Arc::as_ptr(value) as usize;
        if let Some(number) = self.numbers.get(&place).copied() {
            self.put(&(number + 1));
            return;
        }
        self.put(&0_u32);
        save(value, self);
        self.numbers.insert(place, self.held.len() as u32);
        let held: Arc<dyn Any + Send + Sync> = Arc::clone(value) as _;
        self.held.push(held);
    }

    pub(crate) fn refused(&self) -> bool {
        self.refused
    }

    /// What was written; none where something could not be.
    pub(crate) fn finish(self) -> Option<Vec<u8>> {
        (!self.refused).then_some(self.bytes)
    }

    /// Says that this cannot be saved, at least not as it is now: there is no snapshot at this moment.
    pub fn refuse(&mut self) {
        self.refused = true;
    }
}

/// Reads what a [`Saver`] wrote, in the same order.
pub struct Loader<'a> {
    left: &'a [u8],
    context: Option<Arc<dyn Any + Send + Sync>>,
    held: Vec<Arc<dyn Any + Send + Sync>>,
}

impl<'a> Loader<'a> {
    pub(crate) fn new(bytes: &'a [u8], context: Option<Arc<dyn Any + Send + Sync>>) -> Self {
        Self { left: bytes, context, held: Vec::new() }
    }

    /// Everything was read.
    pub(crate) fn is_empty(&self) -> bool {
        self.left.is_empty()
    }

    /// Reads a value.
    pub fn take<T: DeserializeOwned>(&mut self) -> Option<T> {
        let (value, left) = postcard::take_from_bytes(self.left).ok()?;
        self.left = left;
        Some(value)
    }

    /// What the wiring gave to [`crate::Wiring::context`].
    pub fn context<T: Any + Send + Sync>(&self) -> Option<Arc<T>> {
        self.context.clone()?.downcast().ok()
    }

    /// Reads bytes with their length.
    pub fn bytes(&mut self) -> Option<&'a [u8]> {
        let length = self.take()?;
        let (bytes, left) = self.left.split_at_checked(length)?;
        self.left = left;
        Some(bytes)
    }

    /// Reads a value that several own.
    pub fn shared<T: Any + Send + Sync>(
        &mut self,
        load: impl FnOnce(&mut Self) -> Option<T>,
    ) -> Option<Arc<T>> {
        match self.take::<u32>()?.checked_sub(1) {
            Some(number) => Arc::clone(self.held.get(number as usize)?).downcast().ok(),
            None => {
                let value = Arc::new(load(self)?);
                let held: Arc<dyn Any + Send + Sync> = Arc::clone(&value) as _;
                self.held.push(held);
                Some(value)
            }
        }
    }
}
