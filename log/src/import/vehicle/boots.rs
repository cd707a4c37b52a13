//! Chooses the boot of a vehicle that is the flight.

use super::VehicleLog;
use crate::import::LogFault;
use crate::import::boot::Boot;
use crate::import::epoch::Epoch;
use crate::import::tally::Tally;

/// Longest time that a state holds without a new report, s.
const STATE_LASTS: f64 = 10.0;

impl VehicleLog {
    /// Flight time of the vehicle in each epoch, s on the ground's clock: as reported by the
    /// vehicle, or else the time armed.
    pub(in crate::import) fn flown(&self) -> Vec<f64> {
        let states = if self.landed.is_empty() { &self.armed } else { &self.landed };
        let mut flown = vec![0.0; self.epochs.len()];
        let mut last: Option<(usize, f64)> = None;
        for (frame_time, flying) in states {
            let Some(epoch) = self.epoch_at(frame_time.index) else { continue };
            if let Some((before, since)) = last.take()
                && before == epoch
            {
                flown[epoch] += (frame_time.ground - since).clamp(0.0, STATE_LASTS);
            }
            last = flying.then_some((epoch, frame_time.ground));
        }
        // A state that was heard before the first stamp of a boot was taken for the boot before.
        for (flown, epoch) in flown.iter_mut().zip(&self.epochs) {
            let (from, to) = epoch.span();
            *flown = flown.min((to - from).max(0.0));
        }
        flown
    }

    /// The epoch that is the flight: the requested one, counted from 1, or else the one that flew
    /// longest.
    pub(super) fn chosen(
        &self,
        boot: Option<usize>,
        flown: &[f64],
    ) -> Result<Option<usize>, LogFault> {
        let boots = self.epochs.len();
        if let Some(boot) = boot {
            let at = boot.checked_sub(1).filter(|at| *at < boots);
            return at.map(Some).ok_or(LogFault::NoBoot { boot, boots });
        }
        let weight = |epoch: &Epoch, flown: f64| {
            // Whole seconds, since states arrive at a low rate.
            (epoch.attitudes() > 0, flown as u64, epoch.attitudes(), epoch.messages())
        };
        let epochs = self.epochs.iter().zip(flown).enumerate().rev();
        let most = epochs.max_by_key(|(_, (epoch, flown))| weight(epoch, **flown));
        Ok(most.map(|(at, _)| at))
    }

    /// Notes each boot with its time in the air, s, if there are several, and counts the messages
    /// of all but the chosen one.
    pub(super) fn note_boots(
        &self,
        chosen: usize,
        flown: &[f64],
        notes: &mut Vec<String>,
        tally: &mut Tally,
    ) {
        let boot = |(epoch, flown): (&Epoch, &f64)| {
            let (from, to) = epoch.span();
            Boot { span: [from, to], flown: *flown }
        };
        let boots: Vec<Boot> = self.epochs.iter().zip(flown).map(boot).collect();
        notes.extend(Boot::notes(&boots, chosen));
        for (at, epoch) in self.epochs.iter().enumerate().filter(|(at, _)| *at != chosen) {
            let [from, to] = boots[at].span;
            let reason =
                format!("message of another run of the vehicle's clock ({from:.2} to {to:.2} s)");
            tally.add(&reason, epoch.messages() as u64);
        }
    }
}
