//! A flight along a plan, from its records or its log.

use std::collections::VecDeque;
use std::path::Path;

use anyhow::anyhow;
use vehicle::frame::Ned;

use crate::log::LogReader;
use crate::log::info::LogInfo;
use crate::log::reader::{Message, ReadError};
use crate::log::record::{Record, Stamp, Tick};
use crate::log::schema::{ControlMessage, ReferenceMessage, StateMessage, TruthMessage};
use crate::offboard::TRAJECTORY_DONE;
use crate::plan::PositionSource;
use crate::plan::tube::score::FlownPoint;

/// Number of recent true positions kept, among which to find that of a tick's sample.
const TRUTHS: usize = 20;
/// Largest difference between equal positions, m.
const SAME_M: f64 = 1e-6;

/// A flight along a plan.
#[derive(Clone, Debug)]
pub(super) struct Flown {
    /// Name of the tracked trajectory.
    pub mission: String,
    /// Ticks along the trajectory.
    pub points: Vec<FlownPoint>,
    /// Radius of the tube at each point, m; `None` without a tube.
    pub radius_m: Vec<Option<f64>>,
    /// Kind of the flown positions.
    pub position: PositionSource,
    /// Whether the trajectory was flown to its end; [`FlownGatherer::flown`] leaves it false.
    pub is_complete: bool,
    /// Whether the reference was replanned in flight.
    pub is_replanned: bool,
    /// Horizontal speed of the steady wind, m/s; 0 for logs.
    pub wind_m_s: f64,
}

/// Builds a [`Flown`] from records or log messages.
#[derive(Debug, Default)]
pub(super) struct FlownGatherer {
    truths: VecDeque<(u64, Ned)>,
    points: Vec<FlownPoint>,
    radius_m: Vec<Option<f64>>,
    has_truth: bool,
    is_replanned: bool,
    /// State of the tick that is being read from a log.
    state: Option<StateMessage>,
    reference: Option<ReferenceMessage>,
}

/// A tick along the trajectory.
struct Along {
    vehicle_time_us: u64,
    point: FlownPoint,
    radius_m: Option<f64>,
    desired: Ned,
}

impl FlownGatherer {
    /// Adds the next record.
    pub fn on_record(&mut self, record: &Record) {
        match record {
            Record::Truth { stamp, truth } => self.see(*stamp, truth.state.position),
            Record::Tick(tick) => self.add(tick),
            _ => {}
        }
    }

    fn see(&mut self, stamp: Stamp, position: Ned) {
        self.keep(stamp.vehicle_time_us(), position);
    }

    fn keep(&mut self, time_us: u64, position: Ned) {
        if self.truths.len() == TRUTHS {
            self.truths.pop_front();
        }
        self.truths.push_back((time_us, position));
    }

    fn add(&mut self, tick: &Tick) {
        let Some((reference, time_s)) = tick.reference.zip(tick.trajectory_time) else {
            return;
        };
        self.follow(Along {
            vehicle_time_us: tick.stamp.vehicle_time_us(),
            point: FlownPoint {
                time_s,
                planned: reference.position,
                speed_m_s: reference.velocity.norm(),
                flown: tick.state.position,
            },
            radius_m: tick.tube_radius_m,
            desired: tick.desired.unwrap_or(reference.position),
        });
    }

    fn follow(&mut self, along: Along) {
        let Along { vehicle_time_us, mut point, radius_m, desired } = along;
        self.is_replanned |= (desired - point.planned).norm() > SAME_M;
        let nearest = self.truths.iter().min_by_key(|(at, _)| at.abs_diff(vehicle_time_us));
        if let Some((_, position)) = nearest {
            point.flown = *position;
            self.has_truth = true;
        }
        self.points.push(point);
        self.radius_m.push(radius_m);
    }

    /// Reads a flight from a downwash log.
    ///
    /// # Errors
    /// The log cannot be read, tracks no trajectory, or has a replanned reference.
    pub fn read(path: &Path) -> anyhow::Result<Flown> {
        let mut reader = LogReader::open(path).map_err(|error| match error {
            ReadError::NotMcap { .. } => anyhow!("{error}; give downwash logs of tracked flights"),
            error => error.into(),
        })?;
        let mut gatherer = Self::default();
        let info = LogInfo::read_with(&mut reader, |message| gatherer.take(message))?;
        let mission = info.run.get("run").cloned().unwrap_or_default();
        let is_complete = info.events.iter().any(|event| event.text.contains(TRAJECTORY_DONE));
        let flown = gatherer.flown();
        if flown.points.is_empty() {
            return Err(anyhow!(
                "no tick tracks a trajectory; give downwash logs of tracked flights"
            ));
        }
        if flown.is_replanned {
            return Err(anyhow!("its reference was replanned in flight from the vehicle's state"));
        }
        Ok(Flown { mission, is_complete, ..flown })
    }

    fn take(&mut self, message: &Message<'_>) {
        if let Some(truth) = message.decode::<TruthMessage>() {
            let position = Ned::new(truth.p_n_m, truth.p_e_m, truth.p_d_m);
            self.keep(truth.vehicle_time_us, position);
        } else if let Some(state) = message.decode::<StateMessage>() {
            (self.state, self.reference) = (Some(state), None);
        } else if let Some(reference) = message.decode::<ReferenceMessage>() {
            self.reference = Some(reference);
        } else if let Some(control) = message.decode::<ControlMessage>() {
            self.conclude(&control);
        }
    }

    /// Completes a tick with its last message.
    fn conclude(&mut self, control: &ControlMessage) {
        let pair = self.state.take().zip(self.reference.take());
        let Some((state, reference)) = pair.filter(|(_, r)| r.trajectory_time_s.is_finite()) else {
            return;
        };
        let flown = Ned::new(state.p_n_m, state.p_e_m, state.p_d_m);
        let error = Ned::new(control.error_n_m, control.error_e_m, control.error_d_m);
        self.follow(Along {
            vehicle_time_us: state.vehicle_time_us,
            point: FlownPoint {
                time_s: reference.trajectory_time_s,
                planned: Ned::new(reference.p_n_m, reference.p_e_m, reference.p_d_m),
                speed_m_s: Ned::new(reference.v_n_mps, reference.v_e_mps, reference.v_d_mps).norm(),
                flown,
            },
            radius_m: (reference.tube_radius_m > 0.0).then_some(reference.tube_radius_m),
            desired: flown - error,
        });
    }

    /// Returns the flight gathered so far.
    pub fn flown(self) -> Flown {
        Flown {
            mission: String::new(),
            points: self.points,
            radius_m: self.radius_m,
            position: if self.has_truth { PositionSource::True } else { PositionSource::Reported },
            is_complete: false,
            is_replanned: self.is_replanned,
            wind_m_s: 0.0,
        }
    }
}

impl Flown {
    /// The largest ratio of the distance from the plan to the tube's radius. `None` without a tube,
    /// or if a ratio is not finite.
    pub fn share_of_radius(&self) -> Option<f64> {
        let pairs = self.points.iter().zip(&self.radius_m);
        pairs
            .map(|(point, radius)| Some((point.flown - point.planned).norm() / (*radius)?))
            .try_fold(0.0, |most: f64, share| {
                share.filter(|share| share.is_finite()).map(|share| most.max(share))
            })
    }
}
