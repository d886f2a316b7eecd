//! Where stations say how they stand, for whoever looks on while they are at work: panels, pages. No actor reads it.

use std::sync::Arc;

use crossbeam_queue::ArrayQueue;

use super::StationStatus;

/// The newest word of each station.
#[derive(Clone, Debug, Default)]
pub struct Board(Arc<Vec<ArrayQueue<StationStatus>>>);

impl Board {
    /// For so many stations, which have said nothing.
    pub(crate) fn new(stations: u32) -> Self {
        Self(Arc::new((0..stations).map(|_| ArrayQueue::new(1)).collect()))
    }

    pub(super) fn put(&self, station: usize, status: StationStatus) {
        if let Some(place) = self.0.get(station) {
            place.force_push(status);
        }
    }

    /// By number. Who has never had a guest has said nothing.
    pub fn read(&self) -> Vec<StationStatus> {
        let read = |place: &ArrayQueue<StationStatus>| {
            let status = place.pop()?;
            // Something newer may have come meanwhile; that stays.
            let _ = place.push(status.clone());
            Some(status)
        };
        self.0.iter().map(|place| read(place).unwrap_or_default()).collect()
    }
}
