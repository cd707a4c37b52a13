//! The report of a change: onset, cause, size.

use super::Detector;
use crate::onset::cells::CELL_S;
use crate::onset::change::{Change, Other, Value};
use crate::onset::columns::Cause;
use crate::onset::likelihood::{DirectionChange, Grid, Place, Profile, Scale, Window, along};
use crate::onset::noise::ORDER;

/// Errors are correlated over several cells: the differences in evidence between neighbouring
/// onsets shrink by this factor, the square root of the correlation length.
const SHARED: f64 = 3.2;
/// Causes less probable than this are not reported.
const REPORTED: f64 = 0.02;

impl Detector {
    /// The change according to the present data, if it still exceeds the threshold.
    pub(super) fn change(&self, alarmed_s: f64) -> Option<Change> {
        let profiles = self.profiles(Grid::Full);
        let top = profiles.iter().filter_map(peak).map(|place| place.evidence);
        let top = top.fold(f64::NEG_INFINITY, f64::max);
        if top < self.settings.bound() {
            return None;
        }
        let mass = |place: &Place| (place.evidence - top).exp();
        let masses: Vec<f64> =
            profiles.iter().map(|profile| profile.places.iter().map(mass).sum()).collect();
        let total: f64 = masses.iter().sum();
        let mut by_mass: Vec<usize> = (0..profiles.len()).collect();
        by_mass.sort_by(|a, b| masses[*b].total_cmp(&masses[*a]));
        let best = *by_mass.first()?;
        let profile = &profiles[best];
        let peak = peak(profile)?;
        let [low, middle, high] = quantiles(profile);
        let start = |place: usize| self.kept.get(place + ORDER).map(|cell| cell.time);
        let changes = self.changes_of(profile.cause, peak.cell, self.scales()[best])?;
        let others = by_mass[1..].iter().map(|&index| Other {
            cause: profiles[index].cause,
            probability: masses[index] / total,
        });
        Some(Change {
            at_s: start(middle)?,
            // A change that starts within a cell affects half of it, on either side.
            interval_s: [start(low)? - CELL_S, start(high)? + CELL_S],
            alarmed_s,
            cause: profile.cause,
            rotor: profile.cause.rotor(),
            effects: profile.cause.effects().to_vec(),
            probability: masses[best] / total,
            others: others.filter(|other| other.probability >= REPORTED).collect(),
            evidence: peak.evidence,
            values: changes.iter().map(|c| Value::of(c, self.cells.sizes())).collect(),
        })
    }

    /// The changes along the directions of a cause. A second fit to the residual of the first
    /// separates distant data from the vehicle after the change.
    fn changes_of(&self, cause: Cause, cell: usize, scale: Scale) -> Option<Vec<DirectionChange>> {
        let first = self.window.changes(cause, cell, scale)?;
        let mut kept = self.kept.clone();
        for row in kept.iter_mut().skip(cell + ORDER).flat_map(|cell| &mut cell.rows) {
            for change in &first {
                row.residual -= change.change[0] * along(&row.slopes, change.direction);
            }
        }
        let window = Window::of(&kept, &self.noise, &self.reference());
        let mut second = window.changes(cause, cell, scale)?;
        for (change, first) in second.iter_mut().zip(first) {
            change.change = [change.change[0] + first.change[0], first.change[1]];
            change.after = [change.after[0] + first.change[0], first.after[1]];
        }
        Some(second)
    }
}

pub(super) fn peak(profile: &Profile) -> Option<&Place> {
    profile.places.iter().max_by(|a, b| a.evidence.total_cmp(&b.evidence))
}

/// Cells before which 5, 50 and 95 % of the mass lie, from the earliest on.
fn quantiles(profile: &Profile) -> [usize; 3] {
    let top = profile.places.iter().map(|place| place.sharp).fold(f64::NEG_INFINITY, f64::max);
    let mass = |place: &Place| ((place.sharp - top) / SHARED).exp();
    let total: f64 = profile.places.iter().map(mass).sum();
    let mut sum = 0.0;
    let mut found = [None; 3];
    // The places are in order from the latest to the earliest.
    for place in profile.places.iter().rev() {
        sum += mass(place) / total;
        for (found, share) in found.iter_mut().zip([0.05, 0.5, 0.95]) {
            if sum >= share {
                found.get_or_insert(place.cell);
            }
        }
    }
    let last = profile.places.first().map_or(0, |place| place.cell);
    found.map(|cell| cell.unwrap_or(last))
}
