//! The autopilot: it flies the plant and behaves like PX4 or ArduCopter on the wire. Sans I/O: it
//! takes and returns bytes, and its caller advances the time.
//!
//! Once per tick of the on-board loop, [`flight`] turns sensor data into motor outputs. The
//! [`commander`] decides mode and arming, [`guidance`] and [`position`] fly every mode except
//! OFFBOARD, and [`offboard`] holds the setpoint stream. [`protocol`] implements MAVLink. A
//! `personality` holds what differs between the simulated autopilots, including the attitude loop.

mod airframe;
pub mod arming;
pub mod commander;
pub mod commands;
pub mod flight;
mod ftp;
pub mod guidance;
pub mod identity;
pub mod land_detector;
mod link;
mod modes;
pub mod offboard;
pub mod parameters;
pub mod pd;
mod personality;
pub mod position;
pub mod protocol;
mod signing;
pub mod status_text;
pub mod streams;
pub mod telemetry;
#[cfg(test)]
pub(crate) mod testing;
pub mod vision;

pub use link::{LinkKind, Peer};
pub use modes::Mode;

use rand::SeedableRng;
use rand_pcg::Pcg64Mcg;

use self::airframe::Airframe;
use self::flight::{Beginning, FlightControl};
use self::link::Receiver;
use self::parameters::SetError;
use self::personality::NoLoop;
use self::protocol::Protocol;
use crate::clock::Clock;
use crate::config::SitlConfig;
use vehicle::effects::{CommandDelay, EffectSet, PdGain, Schedule};
use vehicle::foreign::Foreign;
use vehicle::plant::Plant;
use vehicle::{VehicleError, VehicleParams};
use wire::signing::{Key, Stamp};

/// MAVLink system id of the vehicle.
pub const SYSTEM_ID: u8 = 1;
/// MAVLink component id of the autopilot.
pub const COMPONENT_ID: u8 = 1;

/// The plant's step, us.
const STEP_US: u64 = 1_000;

/// Largest time to the vehicle's next event, us. It bounds the delay of messages outside the
/// streams.
const EVENT_WITHIN_US: u64 = 20_000;

/// An attitude loop for a vehicle with these moments of inertia, as a table of its file: gains `I
/// w^2` and `2 D I w` with the damping ratio D = 0.9.
fn example_loop(inertia: &[f64; 3]) -> String {
    let axes = || inertia.iter().zip([10.0, 10.0, 5.0]);
    let kp: Vec<_> = axes().map(|(i, w)| format!("{:.3e}", i * w * w)).collect();
    let kd: Vec<_> = axes().map(|(i, w)| format!("{:.3e}", 1.8 * i * w)).collect();
    let (kp, kd) = (kp.join(", "), kd.join(", "));
    format!("[attitude_pd]\nkp = [{kp}]\nkd = [{kd}]\nrate_hz = 250.0")
}

/// Why a vehicle cannot be simulated.
#[derive(Debug, thiserror::Error)]
pub enum VehicleRefused {
    /// The vehicle file has no attitude loop.
    #[error(
        "vehicle {vehicle}: the file has neither attitude_pd nor attitude_cascade, so its \
         autopilot's attitude loop is unknown; add one to simulate the vehicle, such as this, \
         which responds at 10 rad/s in roll and pitch and at 5 rad/s in yaw:\n\n{}",
        example_loop(inertia)
    )]
    NoAttitudeLoop {
        /// Name of the vehicle.
        vehicle: String,
        /// Its moments of inertia, kg m^2.
        inertia: [f64; 3],
    },
    /// A parameter in the configuration is unknown to the autopilot or has an invalid value.
    #[error("SITL configuration: parameters.{name} = {value}: {error}")]
    Parameter {
        /// Its name.
        name: String,
        /// The value.
        value: f64,
        /// Why it is refused.
        error: SetError,
    },
    /// The vehicle file has an impossible value, or lacks a number that an effect needs.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// The simulated vehicle with its autopilot.
///
/// Time is on the vehicle's clock, in microseconds since boot, and only [`Vehicle::advance_to`]
/// advances it. The same seed and the same bytes at the same times produce the same output.
pub struct Vehicle {
    airframe: Airframe,
    protocol: Protocol,
    receivers: Vec<Receiver>,
    now_us: u64,
    stepped_us: u64,
    loop_hz: f64,
    ticks: u64,
    clock: Clock,
}

impl Vehicle {
    /// Creates a vehicle that is switched on at time 0.
    ///
    /// # Errors
    /// [`VehicleRefused`] if the vehicle cannot be simulated.
    pub fn new(
        params: VehicleParams,
        effects: EffectSet,
        config: SitlConfig,
        seed: u64,
    ) -> Result<Self, VehicleRefused> {
        Self::built(params.clone(), params, effects, config, seed)
    }

    /// Creates a vehicle whose firmware uses `params` (loop, mixer, hover thrust), while body,
    /// rotors and link follow `body`. It models a builder's numbers that never quite match the
    /// vehicle.
    ///
    /// # Errors
    /// [`VehicleRefused`] if the vehicle cannot be simulated.
    pub fn built(
        params: VehicleParams,
        body: VehicleParams,
        effects: EffectSet,
        config: SitlConfig,
        seed: u64,
    ) -> Result<Self, VehicleRefused> {
        let (params, body) = (params.checked()?, body.checked()?);
        let airframe = Airframe::new(&body, &effects, &config, seed)?;
        let effects = body.modelled_effects.overlay(&effects);
        let personality = personality::of(config.autopilot);
        let mut onboard = match personality.onboard(&params, effects.get::<PdGain>()) {
            Ok(onboard) => onboard,
            Err(NoLoop::Missing) => {
                return Err(VehicleRefused::NoAttitudeLoop {
                    vehicle: params.name,
                    inertia: params.inertia,
                });
            }
            Err(NoLoop::Vehicle(error)) => return Err(error.into()),
        };
        for (name, value) in &config.parameters {
            onboard.parameters.set_number(name, *value).map_err(|error| {
                VehicleRefused::Parameter { name: name.clone(), value: *value, error }
            })?;
        }
        onboard.attitude_loop.configure(&onboard.parameters);
        let loop_hz = onboard.rate_hz;
        let delay_s =
            effects.get::<CommandDelay>().map_or(body.command_delay_s, |delay| delay.delay_s);
        let (perception, airborne) = (airframe.perceive(), airframe.airborne());
        let flight = FlightControl::new(
            &params,
            personality,
            onboard,
            delay_s,
            &config,
            Beginning { perception, airborne, seed },
        );
        let rng = Pcg64Mcg::seed_from_u64(seed);
        let motor_output = params.motor_output.filter(|_| personality.uses_motor_output());
        let protocol = Protocol::new(flight, airframe.report(), motor_output, config.home, rng);
        Ok(Self {
            airframe,
            protocol,
            receivers: Vec::new(),
            now_us: 0,
            stepped_us: 0,
            loop_hz,
            ticks: 0,
            clock: Clock::new(&config.clock),
        })
    }

    /// Creates a vehicle in which effects set in at times on its clock.
    ///
    /// # Errors
    /// [`VehicleRefused`] if the vehicle cannot be simulated.
    pub fn scheduled(
        params: VehicleParams,
        schedule: Schedule,
        config: SitlConfig,
        seed: u64,
    ) -> Result<Self, VehicleRefused> {
        let Schedule { effects, onsets } = schedule;
        let mut vehicle = Self::new(params.clone(), effects.clone(), config, seed)?;
        vehicle.airframe.schedule(&params.checked()?, &effects, &onsets)?;
        Ok(vehicle)
    }

    /// Adds a disturbance from outside the catalogue from now on; `seed` seeds its random part.
    pub fn disturb(&mut self, foreign: Foreign, seed: u64) {
        self.airframe.disturb(foreign, seed);
    }

    /// Drains the pack to `charge`, 0..1, at once; never raises it.
    pub fn drain(&mut self, charge: f64) {
        self.airframe.drain(charge);
    }

    /// Signs with `key` from now on, as after SETUP_SIGNING, and accepts only frames signed with
    /// it. `now` is the present signing time.
    pub fn sign(&mut self, key: Key, now: Stamp) {
        self.protocol.sign(Some((key, now)));
    }

    /// Starts to serve a peer; streams start before the peer sends anything. Does nothing for a
    /// known peer, or beyond [`protocol::PEERS_MAX`] peers.
    pub fn connect(&mut self, peer: Peer, kind: LinkKind) {
        let known = self.receivers.iter().any(|receiver| receiver.peer == peer);
        if !known && self.protocol.connect(peer) {
            self.receivers.push(Receiver::new(peer, kind));
        }
    }

    /// Removes a peer and its stream rates.
    pub fn disconnect(&mut self, peer: Peer) {
        self.protocol.disconnect(peer);
        self.receivers.retain(|receiver| receiver.peer != peer);
    }

    /// Processes bytes from `peer` at the present time: one datagram, or a piece of a stream.
    /// Connects an unknown peer, whose bytes then count as datagrams.
    pub fn receive(&mut self, peer: Peer, bytes: &[u8]) {
        self.connect(peer, LinkKind::Datagrams);
        let Self { receivers, protocol, .. } = self;
        if let Some(receiver) = receivers.iter_mut().find(|receiver| receiver.peer == peer) {
            receiver.receive(bytes, |frame| protocol.handle(peer, frame));
        }
    }

    /// Advances the time to `time_us`; does nothing if that is in the past.
    ///
    /// In each step of the plant, due messages are sent before the attitude loop ticks. Motor
    /// outputs in a message are therefore those of the previous tick.
    pub fn advance_to(&mut self, time_us: u64) {
        while self.stepped_us + STEP_US <= time_us {
            self.airframe.step(self.protocol.flight.outputs());
            self.stepped_us += STEP_US;
            self.now_us = self.stepped_us;
            self.serve();
        }
        if time_us > self.now_us {
            self.now_us = time_us;
            self.protocol.set_now(time_us);
        }
    }

    fn serve(&mut self) {
        self.protocol.set_now(self.now_us);
        if self.protocol.next_us() <= self.now_us {
            let mut report = self.airframe.report();
            self.protocol.flight.correct(
                &mut report.position,
                &mut report.velocity,
                &mut report.estimator,
            );
            self.protocol.set_report(report);
            self.protocol.stream();
        }
        // Tick k is due at k / loop_hz, rounded up to the plant's steps.
        let due_us = (self.ticks as f64 * 1e6 / self.loop_hz).ceil() as u64;
        if due_us <= self.now_us {
            self.ticks += 1;
            self.protocol.flight.tick(self.now_us, self.airframe.perceive());
            self.protocol.announce();
        }
    }

    /// Vehicle time of the next event, us; after advancing to it, there may be output to take.
    pub fn next_event_us(&self) -> u64 {
        let due_us = self.protocol.next_us().min(self.now_us + EVENT_WITHIN_US);
        due_us.div_ceil(STEP_US).max(self.stepped_us / STEP_US + 1) * STEP_US
    }

    /// Takes the vehicle's output in order, one whole frame per call of `deliver`.
    pub fn take_output(&mut self, deliver: impl FnMut(Peer, &[u8])) {
        self.protocol.take_output(deliver);
    }

    /// Vehicle time, us.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// The map between vehicle time and host time.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Parameters 2 and 3 of MAV_CMD_DO_SET_MODE that select a mode of this autopilot.
    pub fn mode_command(&self, mode: Mode) -> [u8; 2] {
        self.flight().personality.mode_command(mode)
    }

    /// The plant, for the ground truth in logs.
    pub fn plant(&self) -> &Plant {
        self.airframe.plant()
    }

    /// Flight control with the active mode, setpoint and outputs, for logs.
    pub fn flight(&self) -> &FlightControl {
        &self.protocol.flight
    }
}
