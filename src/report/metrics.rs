//! The numbers of a simulated flight, gathered from its records in flight, without a log.

use std::collections::VecDeque;

use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::{Ned, wrap_angle};

use crate::log::record::{Record, Severity, Stamp, Tick, Truth};

/// True states kept to find that of a tick's sample: they are 10 ms apart, and no simulated link is
/// slower than 200 ms.
const TRUTHS: usize = 20;

/// Numbers of one flight; those over the trajectory are `None` where it was never begun.
#[derive(Clone, Debug, Default, PartialEq, JsonSchema, Serialize)]
pub struct Metrics {
    /// How long the trajectory was followed: its ticks over their rate, s.
    pub tracked_s: f64,
    /// Root mean square of the distance from the desired position (of a plan that is flown as it
    /// is, from the plan's), as the controller saw it, north, m.
    pub position_rmse_north_m: Option<f64>,
    /// East, m.
    pub position_rmse_east_m: Option<f64>,
    /// Down, m.
    pub position_rmse_down_m: Option<f64>,
    /// In space, m.
    pub position_rmse_m: Option<f64>,
    /// Greatest distance, m.
    pub position_max_m: Option<f64>,
    /// Root mean square of the true distance, without the sensors' errors, m.
    pub true_position_rmse_m: Option<f64>,
    /// Root mean square of the yaw error, rad.
    pub yaw_rmse_rad: Option<f64>,
    /// Root mean square of the true body rate along the trajectory, rad/s.
    pub body_rate_rms_rad_s: Option<f64>,
    /// Mean collective thrust that was commanded along the trajectory, N.
    pub thrust_mean_n: Option<f64>,
    /// Root mean square of the change of commanded thrust from tick to tick, over the tick, N/s.
    pub thrust_rate_rms_n_s: Option<f64>,
    /// Ticks of the whole flight.
    pub ticks: u64,
    /// Setpoints that were sent.
    pub setpoints: u64,
    /// Ticks in which a limit cut the setpoint.
    pub limited_ticks: u64,
    /// Greatest true tilt from level, rad.
    pub tilt_max_rad: f64,
    /// Greatest true speed, m/s.
    pub speed_max_m_s: f64,
    /// Least voltage that the pack reported, V.
    pub voltage_min_v: Option<f64>,
    /// Events of the level warning and above.
    pub warnings: u64,
}

/// A running mean.
#[derive(Clone, Copy, Debug, Default)]
struct Mean {
    sum: f64,
    count: u64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1;
    }

    fn get(self) -> Option<f64> {
        (self.count > 0).then(|| self.sum / self.count as f64)
    }

    fn root(self) -> Option<f64> {
        self.get().map(f64::sqrt)
    }
}

/// Gathers [`Metrics`].
#[derive(Clone, Debug, Default)]
pub struct MetricsGatherer {
    counted: Metrics,
    truths: VecDeque<(u64, Truth)>,
    axes: [Mean; 3],
    distance: Mean,
    farthest: f64,
    true_distance: Mean,
    yaw: Mean,
    body_rate: Mean,
    thrust: Mean,
    thrust_rate: Mean,
    /// Time and thrust of the last tick along the trajectory.
    last: Option<(u64, f64)>,
}

impl MetricsGatherer {
    /// Takes the next record of the flight.
    pub fn add(&mut self, record: &Record) {
        match record {
            Record::Truth { stamp, truth } => self.add_truth(*stamp, truth),
            Record::Tick(tick) => self.add_tick(tick),
            Record::Battery { voltage: Some(voltage), .. } => {
                let least = self.counted.voltage_min_v.unwrap_or(f64::INFINITY);
                self.counted.voltage_min_v = Some(least.min(*voltage));
            }
            Record::Event { severity, .. } if *severity <= Severity::Warning => {
                self.counted.warnings += 1;
            }
            _ => {}
        }
    }

    fn add_truth(&mut self, stamp: Stamp, truth: &Truth) {
        let state = &truth.state;
        // The cosine of the tilt is the down component of the body's z axis.
        let down = state.attitude.to_world(vehicle::frame::Frd::new(0.0, 0.0, 1.0)).down();
        self.counted.tilt_max_rad = self.counted.tilt_max_rad.max(down.clamp(-1.0, 1.0).acos());
        self.counted.speed_max_m_s = self.counted.speed_max_m_s.max(state.velocity.norm());
        if self.truths.len() == TRUTHS {
            self.truths.pop_front();
        }
        self.truths.push_back((stamp.vehicle_time_us(), *truth));
    }

    fn add_tick(&mut self, tick: &Tick) {
        self.counted.ticks += 1;
        self.counted.setpoints += u64::from(tick.setpoint.is_some());
        self.counted.limited_ticks += u64::from(tick.saturation != 0);
        let Some((reference, _)) = tick.reference.zip(tick.trajectory_time) else {
            self.last = None;
            return;
        };
        let desired = tick.desired.unwrap_or(reference.position);
        let error: Ned = tick.state.position - desired;
        for (axis, component) in self.axes.iter_mut().zip(error.to_array()) {
            axis.add(component.powi(2));
        }
        self.distance.add(error.norm().powi(2));
        self.farthest = self.farthest.max(error.norm());
        let yaw = wrap_angle(tick.state.attitude.euler().yaw - reference.attitude.yaw);
        self.yaw.add(yaw.powi(2));
        let time_us = tick.stamp.vehicle_time_us();
        let nearest = self.truths.iter().min_by_key(|(at_us, _)| at_us.abs_diff(time_us));
        if let Some((_, truth)) = nearest {
            self.true_distance.add((truth.state.position - desired).norm().powi(2));
            self.body_rate.add(truth.state.body_rate.norm().powi(2));
        }
        if let Some(setpoint) = &tick.setpoint {
            self.thrust.add(setpoint.thrust_n);
            if let Some((before_us, thrust_n)) = self.last
                && time_us > before_us
            {
                let rate = (setpoint.thrust_n - thrust_n) / ((time_us - before_us) as f64 * 1e-6);
                self.thrust_rate.add(rate.powi(2));
            }
            self.last = Some((time_us, setpoint.thrust_n));
        }
    }

    /// The numbers of the flight, at a control rate in Hz.
    pub fn metrics(&self, rate_hz: f64) -> Metrics {
        let [north, east, down] = self.axes.map(Mean::root);
        Metrics {
            tracked_s: self.distance.count as f64 / rate_hz,
            position_rmse_north_m: north,
            position_rmse_east_m: east,
            position_rmse_down_m: down,
            position_rmse_m: self.distance.root(),
            position_max_m: (self.distance.count > 0).then_some(self.farthest),
            true_position_rmse_m: self.true_distance.root(),
            yaw_rmse_rad: self.yaw.root(),
            body_rate_rms_rad_s: self.body_rate.root(),
            thrust_mean_n: self.thrust.get(),
            thrust_rate_rms_n_s: self.thrust_rate.root(),
            ..self.counted.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use vehicle::rigid_body::State;

    use super::*;
    use crate::clock::{HostTime, VehicleTime};
    use crate::setpoint::{Reference, Setpoint};

    fn stamp(us: u64) -> Stamp {
        Stamp::new(HostTime::from_ns(us * 1000), VehicleTime::from_us(us), HostTime::default())
    }

    fn at(north: f64) -> State {
        State { position: Ned::new(north, 0.0, 0.0), ..State::default() }
    }

    fn tick(us: u64, north: f64, thrust_n: f64, along: Option<f64>) -> Record {
        Record::Tick(Tick {
            stamp: stamp(us),
            state: at(north),
            reference: Some(Reference::default()),
            desired: None,
            tube_radius_m: None,
            feedback: Setpoint::default(),
            setpoint: Some(Setpoint { thrust_n, ..Setpoint::default() }),
            saturation: 0,
            phase: "track",
            trajectory_time: along,
            sample_age: 0.0,
        })
    }

    #[test]
    fn errors_cover_only_the_tracked_trajectory() {
        let mut gatherer = MetricsGatherer::default();
        // On the way to the start, far away: no part of the error.
        gatherer.add(&tick(0, 9.0, 1.0, None));
        for (us, north, true_north) in [(10_000, 3.0, 1.0), (20_000, -4.0, 2.0)] {
            let truth = Truth { state: at(true_north), ..Truth::default() };
            // The newest truth is not that of the tick's sample.
            gatherer.add(&Record::Truth { stamp: stamp(us), truth });
            let later = Truth { state: at(50.0), ..Truth::default() };
            gatherer.add(&Record::Truth { stamp: stamp(us + 9_000), truth: later });
            gatherer.add(&tick(us, north, 2.0 + us as f64 * 1e-5, Some(us as f64 * 1e-6)));
        }
        let metrics = gatherer.metrics(100.0);
        assert_eq!(metrics.position_rmse_m, Some(12.5_f64.sqrt()));
        assert_eq!(metrics.position_max_m, Some(4.0));
        assert_eq!(metrics.true_position_rmse_m, Some(2.5_f64.sqrt()));
        assert!((metrics.thrust_rate_rms_n_s.unwrap_or_default() - 10.0).abs() < 1e-9);
        assert_eq!((metrics.ticks, metrics.tracked_s), (3, 0.02));
    }

    #[test]
    fn flight_that_never_started_has_no_errors() {
        let metrics = MetricsGatherer::default().metrics(100.0);
        assert_eq!((metrics.position_rmse_m, metrics.tracked_s), (None, 0.0));
    }
}
