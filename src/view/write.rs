//! Viewers' changes, if enabled: a short list of parameters, passed to the control thread through a
//! short queue. The supervisor decides, and all viewers see the resulting values.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};

use foxglove::websocket::{Parameter, ParameterValue};

use crate::offboard::{Adjusted, Adjustment};

/// Changes that may wait for the control thread, which takes ten a second; others are dropped.
const QUEUE: usize = 4;

/// The only parameters that can be set.
pub(super) const WRITABLE: [&str; 4] =
    ["flight.goal_north_m", "flight.goal_east_m", "flight.goal_up_m", "flight.feedback_scale"];

/// The control thread's end of the queue.
pub struct Changes(Receiver<Adjustment>);

impl Changes {
    /// The next change, if any. Never waits.
    pub fn take(&self) -> Option<Adjustment> {
        self.0.try_recv().ok()
    }
}

/// The server's end of the queue.
pub(super) struct Writer {
    queue: SyncSender<Adjustment>,
    /// Number of viewers that connected through the front, which checks the origin of their page,
    /// and of all viewers.
    relayed: Arc<AtomicUsize>,
    all: AtomicUsize,
}

impl Writer {
    pub fn new() -> (Self, Changes) {
        let (queue, changes) = sync_channel(QUEUE);
        (Self { queue, relayed: Arc::default(), all: AtomicUsize::new(0) }, Changes(changes))
    }

    /// The count of viewers that connected through the front.
    pub fn relayed(&self) -> Arc<AtomicUsize> {
        Arc::clone(&self.relayed)
    }

    /// Counts a connected viewer.
    pub fn viewer_connected(&self) {
        self.all.fetch_add(1, Ordering::AcqRel);
    }

    /// Counts a disconnected viewer.
    pub fn viewer_disconnected(&self) {
        self.all.fetch_sub(1, Ordering::AcqRel);
    }

    /// Queues a change. Parameters off the list, values that are not numbers, and changes beyond
    /// the queue's length are dropped.
    pub fn offer(&self, requested: &[Parameter]) {
        // A viewer bypassed the front, and may be the sender.
        if self.all.load(Ordering::Acquire) > self.relayed.load(Ordering::Acquire) {
            tracing::warn!("a viewer's change is dropped: a viewer bypassed the access check");
            return;
        }
        if let Some(change) = change(requested)
            && self.queue.try_send(change).is_err()
        {
            tracing::warn!("a viewer's change is dropped: too many at once");
        }
    }
}

/// The current values, as viewers see them.
pub(super) fn shown_as(held: &Adjusted) -> Vec<(String, String)> {
    let [north, east, down] = held.goal.to_array();
    let values = [north, east, 0.0 - down, held.feedback_scale];
    WRITABLE
        .iter()
        .zip(values)
        .map(|(name, value)| ((*name).to_owned(), value.to_string()))
        .collect()
}

fn change(requested: &[Parameter]) -> Option<Adjustment> {
    let value = |name: &str| {
        let found = requested.iter().find(|parameter| parameter.name == name)?;
        match found.value {
            Some(ParameterValue::Float64(value)) => Some(value),
            Some(ParameterValue::Integer(value)) => Some(value as f64),
            _ => None,
        }
    };
    let [north_m, east_m, up_m, feedback_scale] = WRITABLE.map(value);
    let change = Adjustment { north_m, east_m, up_m, feedback_scale };
    (change != Adjustment::default()).then_some(change)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changes_are_ignored_while_a_viewer_bypasses_the_front() {
        let (writer, changes) = Writer::new();
        let requested = [Parameter::float64(WRITABLE[0], 0.5)];
        writer.relayed().fetch_add(1, Ordering::AcqRel);
        writer.viewer_connected();
        writer.offer(&requested);
        assert!(changes.take().is_some());
        writer.viewer_connected();
        writer.offer(&requested);
        assert_eq!(changes.take(), None);
        writer.viewer_disconnected();
        writer.offer(&requested);
        assert!(changes.take().is_some());
    }
}
