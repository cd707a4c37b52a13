//! The autopilot: behaves on the wire as PX4 or ArduCopter does, flies the plant. Sans I/O: bytes
//! in, bytes out, time passed in.
//!
//! Once per tick of the on-board loop, [`flight`] turns what is sensed into motor outputs: the
//! [`commander`] rules over mode and arming, [`guidance`] and [`position`] fly every mode but
//! OFFBOARD, [`offboard`] holds the setpoint stream. [`protocol`] speaks MAVLink around it. What
//! differs between the autopilots that the vehicle can be, and the attitude loop of each, is a
//! `personality`.

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

/// The vehicle's next event is never further away than this, us: so soon does a change that no
/// stream carries reach its peers.
const EVENT_WITHIN_US: u64 = 20_000;

/// An attitude loop for a vehicle of these moments of inertia, as a table of its file: `I w^2` and
/// `2 D I w`, damping ratio D 0.9.
fn example_loop(inertia: &[f64; 3]) -> String {
    let axes = || inertia.iter().zip([10.0, 10.0, 5.0]);
    let kp: Vec<_> = axes().map(|(i, w)| format!("{:.3e}", i * w * w)).collect();
    let kd: Vec<_> = axes().map(|(i, w)| format!("{:.3e}", 1.8 * i * w)).collect();
    let (kp, kd) = (kp.join(", "), kd.join(", "));
    format!("[attitude_pd]\nkp = [{kp}]\nkd = [{kd}]\nrate_hz = 250.0")
}

/// Why a vehicle does not fly.
#[derive(Debug, thiserror::Error)]
pub enum VehicleRefused {
    /// The vehicle file has no attitude loop that the autopilot flies.
    #[error(
        "vehicle {vehicle}: the file has neither attitude_pd nor attitude_cascade, so its \
         autopilot's attitude loop is not known; add it to simulate the vehicle, such as this, which \
         answers at 10 rad/s in roll and pitch and at 5 rad/s in yaw:\n\n{}",
        example_loop(inertia)
    )]
    NoAttitudeLoop {
        /// The vehicle's name.
        vehicle: String,
        /// Its moments of inertia, kg m^2.
        inertia: [f64; 3],
    },
    /// A parameter of the configuration is not one of the autopilot's, or cannot have the value.
    #[error("SITL configuration: parameters.{name} = {value}: {error}")]
    Parameter {
        /// Its name.
        name: String,
        /// The value.
        value: f64,
        /// What is wrong.
        error: SetError,
    },
    /// The vehicle file holds what cannot be, or lacks what an effect needs.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
}

/// The simulated vehicle.
///
/// Time is the vehicle's own, microseconds since its boot, and only [`Vehicle::advance_to`] moves
/// it. The same seed and the same bytes at the same times give the same bytes out.
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
    /// A vehicle switched on at time 0.
    ///
    /// # Errors
    /// [`VehicleRefused`].
    pub fn new(
        params: VehicleParams,
        effects: EffectSet,
        config: SitlConfig,
        seed: u64,
    ) -> Result<Self, VehicleRefused> {
        Self::built(params.clone(), params, effects, config, seed)
    }

    /// A vehicle whose firmware believes `params` (its loop, its mixer, its hover thrust), and whose
    /// body, rotors and link are `body`'s, as a builder's numbers are never quite the vehicle's.
    ///
    /// # Errors
    /// [`VehicleRefused`].
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
        let motor_output = params.motor_output.filter(|_| personality.heeds_motor_output());
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

    /// A vehicle in which effects set in, at times of its clock.
    ///
    /// # Errors
    /// [`VehicleRefused`].
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

    /// Lets something from outside the catalogue act on the vehicle from now on, beside what does
    /// already; `seed` draws what of it is random.
    pub fn disturb(&mut self, foreign: Foreign, seed: u64) {
        self.airframe.disturb(foreign, seed);
    }

    /// The pack is down to this charge, 0..1, at once.
    pub fn drain(&mut self, charge: f64) {
        self.airframe.drain(charge);
    }

    /// Signs with `key` from now on, as if it had been set up, and believes only what is signed with
    /// it. It is `now`.
    pub fn sign(&mut self, key: Key, now: Stamp) {
        self.protocol.sign(Some((key, now)));
    }

    /// Begins to serve a peer: streams go to it before it says anything. A peer that is already
    /// served stays as it is; beyond [`protocol::PEERS_MAX`] peers a new one is not served.
    pub fn connect(&mut self, peer: Peer, kind: LinkKind) {
        let known = self.receivers.iter().any(|receiver| receiver.peer == peer);
        if !known && self.protocol.connect(peer) {
            self.receivers.push(Receiver::new(peer, kind));
        }
    }

    /// Forgets a peer and its rates.
    pub fn disconnect(&mut self, peer: Peer) {
        self.protocol.disconnect(peer);
        self.receivers.retain(|receiver| receiver.peer != peer);
    }

    /// Takes bytes from `peer` at the present time: one datagram, or a piece of a stream. A peer
    /// that was not connected before is served from now on, its bytes taken as datagrams.
    pub fn receive(&mut self, peer: Peer, bytes: &[u8]) {
        self.connect(peer, LinkKind::Datagrams);
        let Self { receivers, protocol, .. } = self;
        if let Some(receiver) = receivers.iter_mut().find(|receiver| receiver.peer == peer) {
            receiver.receive(bytes, |frame| protocol.handle(peer, frame));
        }
    }

    /// Lets time pass until `time_us`; does nothing if that is past.
    ///
    /// At each step of the plant that something is due in, messages are sent first and the
    /// attitude loop ticks then: motor outputs in a message are those of the latest tick before it.
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
        // Tick k is due at k / loop_hz, on the plant's grid.
        let due_us = (self.ticks as f64 * 1e6 / self.loop_hz).ceil() as u64;
        if due_us <= self.now_us {
            self.ticks += 1;
            self.protocol.flight.tick(self.now_us, self.airframe.perceive());
            self.protocol.announce();
        }
    }

    /// The vehicle time of the next event: after advancing to it, there may be output to take.
    pub fn next_event_us(&self) -> u64 {
        let due_us = self.protocol.next_us().min(self.now_us + EVENT_WITHIN_US);
        due_us.div_ceil(STEP_US).max(self.stepped_us / STEP_US + 1) * STEP_US
    }

    /// Takes what the vehicle has sent, in order: one whole frame per call of `deliver`.
    pub fn take_output(&mut self, deliver: impl FnMut(Peer, &[u8])) {
        self.protocol.take_output(deliver);
    }

    /// Vehicle time, us.
    pub fn now_us(&self) -> u64 {
        self.now_us
    }

    /// Vehicle time against host time.
    pub fn clock(&self) -> &Clock {
        &self.clock
    }

    /// Parameters 2 and 3 of MAV_CMD_DO_SET_MODE that choose a mode of this autopilot.
    pub fn mode_command(&self, mode: Mode) -> [u8; 2] {
        self.flight().personality.mode_command(mode)
    }

    /// The physics under the vehicle: the truth, for logs.
    pub fn plant(&self) -> &Plant {
        self.airframe.plant()
    }

    /// Flight control: mode, setpoint and outputs in force, for logs.
    pub fn flight(&self) -> &FlightControl {
        &self.protocol.flight
    }
}
