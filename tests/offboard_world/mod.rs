//! A vehicle for the offboard controller: rigid body, on-board PD, first-order rotors, transport
//! delay, modes and arming. Its equations are independent of the model, so that they share no
//! mistakes.

use std::collections::VecDeque;
use std::time::Duration;

use downwash::clock::{HostTime, VehicleTime};
use downwash::control::{AttitudeLoop, ControlSettings, HoverVehicle, Lqr};
use downwash::link::received::Received;
use downwash::offboard::{Airframe, OffboardController, OffboardSettings, Tick};
use downwash::plan::reference::ReferenceSource;
use downwash::setpoint::{Reference, Setpoint, State};
use downwash::supervisor::{Action, EngagePolicy, Event, FlightState, ModeMap};
use message::{Inbound, LandedState, SystemState};
use vehicle::frame::{Attitude, Euler, Frd, Ned, wrap_angle};

pub const MODES: ModeMap = ModeMap {
    autopilot: "PX4",
    offboard: 0x0006_0000,
    hold: Some(HOLD_MODE),
    land: 0x0604_0000,
    reports_intended: true,
    names: &[(0x0003_0000, "Position"), (0x0504_0000, "Return")],
};
pub const HOLD_MODE: u32 = 0x0304_0000;
pub const POSITION_MODE: u32 = 0x0003_0000;
const START: HostTime = HostTime::from_ns(1_700_000_000_000_000_000);

pub struct Numbers {
    pub mass: f64,
    pub inertia: [f64; 3],
    pub kp: [f64; 3],
    pub kd: [f64; 3],
    pub thrust_full: f64,
}

pub const NANO: Numbers = Numbers {
    mass: 0.0343,
    inertia: [1.665e-5, 1.745e-5, 3.145e-5],
    kp: [0.00524, 0.00549, 0.00242],
    kd: [0.000508, 0.000534, 0.000525],
    thrust_full: 0.6586,
};

pub const QUAD: Numbers = Numbers {
    mass: 1.218,
    inertia: [0.01122, 0.01231, 0.02062],
    kp: [1.464, 1.607, 0.355],
    kd: [0.1916, 0.2248, 0.1634],
    thrust_full: 26.19,
};

pub fn airframe(numbers: &Numbers) -> Airframe {
    Airframe {
        hover: HoverVehicle { mass_kg: numbers.mass, inertia: numbers.inertia, gravity: 9.81 },
        thrust_full_n: numbers.thrust_full,
        battery_full_v: 4.2,
        modes: MODES,
    }
}

pub fn lqr(numbers: &Numbers) -> Lqr {
    let attitude_loop = AttitudeLoop::Pd { kp: numbers.kp, kd: numbers.kd };
    let hover = airframe(numbers).hover;
    Lqr::design(&hover, &attitude_loop, &ControlSettings::default()).expect("a gain")
}

/// The vehicle.
pub struct Vehicle {
    numbers: Numbers,
    pub state: State,
    /// Thrust and moments, after the lag.
    wrench: [f64; 4],
    lag_s: f64,
    delay_ms: u64,
    queue: VecDeque<(u64, Setpoint)>,
    setpoint: Setpoint,
    pub armed: bool,
    pub mode: u32,
    pub system: SystemState,
    /// Whether its land detector fails.
    pub stays_armed: bool,
    pub ms: u64,
}

impl Vehicle {
    pub fn new(numbers: Numbers, lag_s: f64, delay_ms: u64) -> Self {
        Self {
            numbers,
            state: State::default(),
            wrench: [0.0; 4],
            lag_s,
            delay_ms,
            queue: VecDeque::new(),
            setpoint: Setpoint::default(),
            armed: false,
            mode: HOLD_MODE,
            system: SystemState::Standby,
            stays_armed: false,
            ms: 5000,
        }
    }

    pub fn now(&self) -> HostTime {
        START + Duration::from_millis(self.ms)
    }

    fn on_ground(&self) -> bool {
        self.state.position.down() >= -0.02
    }

    pub fn obey(&mut self, action: Action) {
        match action {
            Action::SetModeOffboard => self.mode = MODES.offboard,
            Action::SetModeHold => self.mode = HOLD_MODE,
            Action::SetModeLand => self.mode = MODES.land,
            Action::Arm => self.armed = true,
            Action::Disarm => self.armed = false,
        }
    }

    pub fn send(&mut self, setpoint: Setpoint) {
        self.queue.push_back((self.ms + self.delay_ms, setpoint));
    }

    /// One millisecond.
    pub fn step(&mut self) {
        self.ms += 1;
        while self.queue.front().is_some_and(|(due, _)| *due <= self.ms) {
            self.setpoint = self.queue.pop_front().map_or(self.setpoint, |(_, s)| s);
        }
        if self.ms.is_multiple_of(4) {
            self.board();
        }
        self.integrate(1e-3);
        let landing = self.mode == MODES.land;
        if landing && !self.stays_armed && self.on_ground() && self.state.velocity.norm() < 0.1 {
            self.armed = false;
        }
    }

    /// The PD and the rotor commands.
    fn board(&mut self) {
        let zeta = self.state.attitude.euler();
        let mut wanted = self.setpoint;
        if self.mode != MODES.offboard {
            let sink = self.state.velocity.down() - if self.mode == MODES.land { 0.4 } else { 0.0 };
            let weight = self.numbers.mass * 9.81;
            wanted.thrust_n = weight * (1.0 + 0.3 * sink);
            wanted.attitude = Euler::new(0.0, 0.0, zeta.yaw);
            wanted.body_rate = Frd::zero();
        }
        let error = [
            wanted.attitude.roll - zeta.roll,
            wanted.attitude.pitch - zeta.pitch,
            wrap_angle(wanted.attitude.yaw - zeta.yaw),
        ];
        let rate = self.state.body_rate.to_array();
        let rate_wanted = wanted.body_rate.to_array();
        let command: [f64; 4] = std::array::from_fn(|i| match i.checked_sub(1) {
            None => wanted.thrust_n,
            Some(i) => {
                self.numbers.kp[i] * error[i] + self.numbers.kd[i] * (rate_wanted[i] - rate[i])
            }
        });
        let gain = if self.lag_s > 0.0 { 1.0 - (-0.004 / self.lag_s).exp() } else { 1.0 };
        for (state, command) in self.wrench.iter_mut().zip(command) {
            *state += gain * (if self.armed { command } else { 0.0 } - *state);
        }
    }

    fn integrate(&mut self, dt: f64) {
        let [thrust, mx, my, mz] = self.wrench;
        let [p, q, r] = self.state.body_rate.to_array();
        let [jx, jy, jz] = self.numbers.inertia;
        let specific = Frd::new(0.0, 0.0, -thrust / self.numbers.mass);
        let acceleration = self.state.attitude.to_world(specific) + Ned::new(0.0, 0.0, 9.81);
        self.state.velocity += acceleration * dt;
        self.state.position += self.state.velocity * dt;
        let turn = Frd::new(
            (mx - (jz - jy) * q * r) / jx,
            (my - (jx - jz) * r * p) / jy,
            (mz - (jy - jx) * p * q) / jz,
        );
        self.state.body_rate += turn * dt;
        let [dw, dx, dy, dz] = self.state.attitude.derivative(self.state.body_rate);
        let a = self.state.attitude;
        self.state.attitude =
            Attitude { w: a.w + dw * dt, x: a.x + dx * dt, y: a.y + dy * dt, z: a.z + dz * dt }
                .normalized();
        let p = self.state.position;
        if p.down() > 0.0 && self.state.velocity.down() > 0.0 {
            // The floor prevents sinking, sliding and tilting.
            let yaw = self.state.attitude.euler().yaw;
            self.state = State {
                position: Ned::new(p.north(), p.east(), 0.0),
                attitude: Euler::new(0.0, 0.0, yaw).attitude(),
                ..State::default()
            };
        }
    }

    /// The messages of this millisecond.
    pub fn messages(&self) -> Vec<Received> {
        let (ms, state) = (self.ms, self.state);
        let mut out = Vec::new();
        let stamp = VehicleTime::from_ms(ms as u32);
        let mut say = |message| {
            out.push(Received { host: self.now(), vehicle: Some(stamp), delay: None, message });
        };
        if ms.is_multiple_of(1000) {
            say(Inbound::Heartbeat {
                autopilot: 12,
                vehicle_type: 2,
                armed: self.armed,
                custom_mode: self.mode,
                system: self.system,
            });
        }
        if ms.is_multiple_of(100) {
            say(Inbound::CurrentMode { custom_mode: self.mode, intended_custom_mode: self.mode });
            let landed = if self.on_ground() { LandedState::OnGround } else { LandedState::InAir };
            say(Inbound::LandedState(landed));
        }
        if ms.is_multiple_of(10) {
            say(Inbound::Odometry {
                position: state.position,
                velocity: state.velocity,
                attitude: state.attitude,
                body_rate: state.body_rate,
                reset_counter: 0,
            });
        }
        out
    }
}

/// An offboard controller and a vehicle, run in step.
pub struct Flight {
    pub offboard: OffboardController,
    pub vehicle: Vehicle,
    pub ticks: Vec<Tick>,
    pub events: Vec<Event>,
    pub actions: Vec<Action>,
    /// Which of the vehicle's messages reach the controller.
    pub receives: fn(&Inbound) -> bool,
    /// Whether the controller's requests take effect.
    pub obeys: fn(Action) -> bool,
}

impl Flight {
    pub fn new(
        vehicle: Vehicle,
        policy: EngagePolicy,
        source: impl ReferenceSource + Send + 'static,
        settings: OffboardSettings,
    ) -> Self {
        let airframe = airframe(&vehicle.numbers);
        let lqr = lqr(&vehicle.numbers);
        let offboard = OffboardController::new(
            settings,
            policy,
            airframe,
            lqr,
            Box::new(source),
            Vec::new(),
            vehicle.now(),
        );
        let (ticks, events, actions) = Default::default();
        Self { offboard, vehicle, ticks, events, actions, receives: |_| true, obeys: |_| true }
    }

    pub fn run(&mut self, seconds: f64) {
        for _ in 0..(seconds * 1000.0) as u64 {
            self.vehicle.step();
            for message in self.vehicle.messages() {
                if !(self.receives)(&message.message) {
                    continue;
                }
                if let Some(tick) = self.offboard.handle(&message) {
                    let cleared = self.offboard.clear(message.host);
                    assert_eq!(cleared.as_ref().map(|it| *it.setpoint()), tick.setpoint);
                    self.offboard.sent(cleared.is_some());
                    if let Some(cleared) = cleared {
                        self.vehicle.send(*cleared.setpoint());
                    }
                    self.ticks.push(tick);
                }
            }
            if self.vehicle.ms.is_multiple_of(20) {
                self.offboard.poll(self.vehicle.now());
            }
            for action in self.offboard.take_actions() {
                self.actions.push(action);
                if (self.obeys)(action) {
                    self.vehicle.obey(action);
                    self.heartbeat();
                }
            }
            self.events.extend(self.offboard.take_events());
        }
    }

    /// Runs until the state is reached, at most `seconds`.
    pub fn until(&mut self, state: FlightState, seconds: f64) {
        for _ in 0..(seconds * 100.0) as u64 {
            if self.offboard.flight_state() == state {
                return;
            }
            self.run(0.01);
        }
        panic!("{state:?} not reached in {seconds} s: {:#?}", self.events);
    }

    /// Sends a HEARTBEAT after `armed` has changed.
    fn heartbeat(&mut self) {
        let message = Inbound::Heartbeat {
            autopilot: 12,
            vehicle_type: 2,
            armed: self.vehicle.armed,
            custom_mode: self.vehicle.mode,
            system: self.vehicle.system,
        };
        if (self.receives)(&message) {
            let host = self.vehicle.now();
            self.offboard.handle(&Received { host, vehicle: None, delay: None, message });
        }
    }

    pub fn switch(&mut self, mode: u32) {
        self.vehicle.mode = mode;
        self.heartbeat();
        let message = Inbound::CurrentMode { custom_mode: mode, intended_custom_mode: mode };
        let host = self.vehicle.now();
        self.offboard.handle(&Received { host, vehicle: None, delay: None, message });
    }

    pub fn streamed_since(&self, host: HostTime) -> usize {
        self.ticks.iter().filter(|tick| tick.host > host && tick.setpoint.is_some()).count()
    }
}

/// A reference that is a function of time.
pub struct Curve<F>(pub f64, pub F);

impl<F: Fn(f64) -> (Ned, Ned, f64, f64)> ReferenceSource for Curve<F> {
    fn duration(&self) -> f64 {
        self.0
    }

    /// The function gives position, velocity, yaw and yaw rate; feedback supplies the thrust.
    fn sample(&self, t: f64) -> Reference {
        let (position, velocity, yaw, yaw_rate) = self.1(t.clamp(0.0, self.0));
        let attitude = Euler::new(0.0, 0.0, wrap_angle(yaw));
        let body_rate = Frd::new(0.0, 0.0, yaw_rate);
        let feedforward = Setpoint { thrust_n: 0.0, attitude, body_rate };
        Reference { position, velocity, attitude, body_rate, feedforward }
    }
}

/// [`Curve`] with the hover thrust of `numbers` as feedforward.
pub struct Hovering<S>(pub S, pub f64);

impl<S: ReferenceSource> ReferenceSource for Hovering<S> {
    fn duration(&self) -> f64 {
        self.0.duration()
    }

    fn sample(&self, t: f64) -> Reference {
        let mut reference = self.0.sample(t);
        reference.feedforward.thrust_n = self.1;
        reference
    }
}

pub fn weight(numbers: &Numbers) -> f64 {
    numbers.mass * 9.81
}
