//! The vehicle's health in flight: detects changes of the vehicle from the records of its log. It
//! runs in the log's thread, reports what it finds, and commands nothing.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use vehicle::{ROTORS, VehicleError, VehicleParams};

use crate::clock::HostTime;
use crate::log::import::{OutputRange, output_ranges};
use crate::log::record::{Record, Severity, Source, Tick, stated_parameter};
use crate::log::sink::Listener;
use crate::onset::cells::Sample;
use crate::onset::change::Change;
use crate::onset::detector::{Detector, Event, Settings};
use crate::onset::text;

/// Flight states in which only the air acts on the vehicle.
const FLYING: [&str; 3] = ["approach", "track", "hold"];
/// Changes that are kept until someone asks for them.
const KEPT: usize = 16;
/// Outputs above this are not shares.
const SHARE_MAX: f32 = 1.5;

/// What is known about the vehicle's health.
#[derive(Clone, Debug, Default)]
pub struct Health {
    /// The present evidence for a change, nats; `None` before enough was flown.
    pub evidence: Option<f64>,
    /// The evidence from which on the monitor reports a change, nats.
    pub bound: f64,
    /// Changes so far.
    pub count: u64,
    /// The newest change, as a message.
    pub latest: Option<String>,
}

/// Access to the health from another thread.
#[derive(Clone, Debug, Default)]
pub struct HealthView(Arc<Mutex<Health>>);

impl HealthView {
    /// The present health.
    pub fn get(&self) -> Health {
        self.lock().clone()
    }

    fn lock(&self) -> MutexGuard<'_, Health> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Watches the records of a run for changes of the vehicle.
pub struct Monitor {
    detector: Detector,
    view: HealthView,
    motor_output: Option<OutputRange>,
    parameters: BTreeMap<String, f64>,
    ranges: Option<[OutputRange; ROTORS]>,
    is_flying: bool,
    /// Whether gyro records arrive besides the state's body rate.
    has_gyro: bool,
    now: HostTime,
    remarks: VecDeque<Record>,
    changes: VecDeque<Change>,
}

impl Monitor {
    /// A monitor for a vehicle with these parameters.
    ///
    /// # Errors
    /// The physics model rejects the parameters.
    pub fn new(vehicle: &VehicleParams, settings: Settings) -> Result<Self, VehicleError> {
        let view = HealthView::default();
        view.lock().bound = settings.bound();
        Ok(Self {
            detector: Detector::new(vehicle, settings)?,
            view,
            motor_output: vehicle
                .motor_output
                .as_ref()
                .map(|unit| OutputRange { zero: unit.zero, one: unit.one }),
            parameters: BTreeMap::new(),
            ranges: None,
            is_flying: false,
            has_gyro: false,
            now: HostTime::default(),
            remarks: VecDeque::new(),
            changes: VecDeque::with_capacity(KEPT),
        })
    }

    /// Access for a thread that shows the health.
    pub fn view(&self) -> HealthView {
        self.view.clone()
    }

    /// The newest changes, each once.
    pub fn take_changes(&mut self) -> impl Iterator<Item = Change> + '_ {
        self.changes.drain(..)
    }

    fn push(&mut self, time_s: f64, sample: Sample) {
        let Self { detector, view, remarks, changes, now, .. } = self;
        detector.push(time_s, sample, |event| match event {
            Event::Look(look) => view.lock().evidence = Some(look.evidence),
            Event::Change(change) => {
                let text = format!("the vehicle changed at {}", text::line(&change));
                remarks.push_back(Record::Event {
                    host: *now,
                    severity: Severity::Warning,
                    source: Source::Daemon,
                    text: text.clone(),
                });
                if changes.len() == KEPT {
                    changes.pop_front();
                }
                changes.push_back(*change);
                let mut health = view.lock();
                health.count += 1;
                health.latest = Some(text);
            }
        });
    }

    fn tick(&mut self, tick: &Tick) {
        let Some(vehicle) = tick.stamp.vehicle else { return };
        self.now = tick.stamp.host;
        let time_s = vehicle.as_us() as f64 * 1e-6;
        // On the ground, in a climb from it and under the autopilot's own control, other forces
        // act.
        let is_flying = tick.setpoint.is_some() && FLYING.contains(&tick.phase);
        if !is_flying {
            if std::mem::take(&mut self.is_flying) {
                self.push(time_s, Sample::Pause);
                self.view.lock().evidence = None;
            }
            return;
        }
        self.is_flying = true;
        let state = tick.state;
        self.push(time_s, Sample::Position(state.position));
        self.push(time_s, Sample::Velocity(state.velocity));
        if !self.has_gyro {
            self.push(time_s, Sample::BodyRate(state.body_rate));
        }
        self.push(time_s, Sample::Attitude(state.attitude));
    }

    /// Outputs as shares of the full thrust, from what is known about their unit.
    pub fn shares_of(&self, outputs: [f32; ROTORS]) -> Option<[f64; ROTORS]> {
        if let Some(range) = self.motor_output {
            return Some(outputs.map(|output| range.fraction(output.into())));
        }
        if outputs.iter().all(|output| (0.0..=SHARE_MAX).contains(output)) {
            return Some(outputs.map(f64::from));
        }
        let ranges = self.ranges?;
        Some(std::array::from_fn(|i| ranges[i].fraction(outputs[i].into())))
    }

    /// Like [`shares_of`](Self::shares_of), and looks up the range once its parameters are known.
    fn shares(&mut self, outputs: [f32; ROTORS]) -> Option<[f64; ROTORS]> {
        if self.ranges.is_none() && !self.parameters.is_empty() {
            let most = outputs.into_iter().fold(0.0, f32::max);
            self.ranges = output_ranges(&self.parameters, most.into());
        }
        self.shares_of(outputs)
    }
}

impl Listener for Monitor {
    fn on_record(&mut self, record: &Record) {
        let seconds = |stamp: &crate::log::record::Stamp| {
            stamp.vehicle.map(|vehicle| vehicle.as_us() as f64 * 1e-6)
        };
        match record {
            Record::Tick(tick) => self.tick(tick),
            Record::Facts(facts) => {
                let stated = facts.iter().filter_map(|(key, value)| stated_parameter(key, value));
                self.parameters.extend(stated);
            }
            _ if !self.is_flying => {}
            Record::Imu { stamp, specific_force, body_rate } => {
                if let Some(time_s) = seconds(stamp) {
                    self.has_gyro = true;
                    self.push(time_s, Sample::SpecificForce(*specific_force));
                    self.push(time_s, Sample::BodyRate(*body_rate));
                }
            }
            Record::Motors { stamp, outputs } => {
                if let Some((time_s, shares)) = seconds(stamp).zip(self.shares(*outputs)) {
                    self.push(time_s, Sample::Outputs(shares));
                }
            }
            Record::Battery { stamp, voltage: Some(volts), .. } => {
                if let Some(time_s) = seconds(stamp) {
                    self.push(time_s, Sample::Voltage(*volts));
                }
            }
            _ => {}
        }
    }

    fn remark(&mut self) -> Option<Record> {
        self.remarks.pop_front()
    }
}
