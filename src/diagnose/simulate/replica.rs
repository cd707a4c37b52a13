//! Replicas: flights as a candidate vehicle would have flown them.
//!
//! The plant flies the logged course in closed loop, and the on-board law follows the logged
//! setpoints. A soft loop about the smoothed position and velocity of the log corrects the
//! setpoints, so that model errors do not carry the replica off its course. It is slow compared
//! with everything that is measured. Without the smoothing it would remove the noise that the
//! controller's feedback put into the setpoints. Sensors report with noise at the exact stamps of
//! the log. A replica thus goes through the same analysis as the flight, including the noise that
//! feedback puts into the outputs, aliasing between rates, and interpolation.

use rand::{Rng, SeedableRng};
use rand_distr::{Distribution, Exp1};
use rand_pcg::Pcg64Mcg;
use sitl::autopilot::offboard::JITTER_MEAN_S;
use sitl::autopilot::pd::AttitudeLoop;
use sitl::config::SitlConfig;
use sitl::sensors::{Readings, Sensors};
use vehicle::effects::EffectSet;
use vehicle::frame::{Attitude, Euler, Frd, Ned, wrap_angle};
use vehicle::plant::Plant;
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleError};

use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::flights::onboard::{AGE_MAX_S, OnboardLaw};
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::flights::series::{Series, next_to};
use crate::diagnose::flights::setpoints::as_onboard;
use crate::diagnose::flights::setpoints::{as_flown, infer};
use crate::diagnose::likelihood::noise::ReportNoise;
use crate::log::import::{AttitudeSetpoint, Stream};

/// Bandwidth of the loop about the logged course, rad/s, and its acceleration limit, m/s^2.
const COURSE_RAD_S: f64 = 1.0;
const COURSE_MAX: f64 = 3.0;
/// The course is averaged over this time to each side, s.
const COURSE_SMOOTHING_S: f64 = 0.12;
/// Gain from attitude error to body rate, where setpoints are body rates, 1/s.
const RATE_GAIN: f64 = 4.0;
/// Time before a span over which rotors and delays act on it, s.
const WARM_UP_S: f64 = 0.4;

/// A vehicle that flies logged flights again.
#[derive(Clone, Debug)]
pub struct Replica {
    plant: Plant,
    effects: EffectSet,
    config: SitlConfig,
    attitude_loop: AttitudeLoop,
    law: OnboardLaw,
    /// Mass (kg) and gravity (m/s^2) in the vehicle file.
    mass: f64,
    gravity: f64,
    /// Delay from sending a setpoint to its use, s.
    command_delay: f64,
    /// Delay from a logged output to its thrust, s.
    output_delay: f64,
    /// Latency of the reported pose, s.
    latency: f64,
    /// Rotates the reported attitude to the true one.
    untrim: Attitude,
}

impl Replica {
    /// The vehicle with the numbers `values`, whose sensors have `noise`. `onboard` is the law that
    /// follows the setpoints.
    ///
    /// # Errors
    /// A vehicle that the physics rejects.
    pub fn new(
        catalogue: &Catalogue,
        values: &[f64],
        noise: &ReportNoise,
        onboard: &OnboardLaw,
    ) -> Result<Self, VehicleError> {
        let candidate = catalogue.candidate(values)?;
        let nominal = &catalogue.vehicle;
        let (vehicle, overlay) = catalogue.vehicle_of(values);
        let config = SitlConfig { sensors: noise.sensors(), ..SitlConfig::default() };
        Ok(Self {
            plant: Plant::new(&vehicle, &overlay, &config.plant(), 0)?
                .airborne()
                .midpoint(Plant::STEP_US),
            effects: vehicle.modelled_effects.overlay(&overlay),
            config,
            attitude_loop: onboard.with_gains(candidate.gains),
            law: onboard.clone(),
            mass: nominal.mass,
            gravity: nominal.gravity,
            command_delay: candidate.command_delay,
            output_delay: candidate.output_delay,
            latency: candidate.latency,
            untrim: candidate.trim.map_or(Attitude::default(), |trim| trim.rotation().inverse()),
        })
    }

    /// Flies `flight` again; data outside its airborne spans stay as they are.
    pub fn fly(&self, flight: &PreparedFlight, seed: u64) -> PreparedFlight {
        let mut replica = flight.clone();
        let mut flown = as_flown(&flight.setpoint, &flight.inferred, !seed);
        for (index, span) in flight.spans.iter().enumerate() {
            let seed = seed.wrapping_add((index as u64) << 40);
            self.fly_span(flight, span.clone(), seed, &mut flown, &mut replica);
        }
        // Setpoints that the log lacks are interpolated again.
        let mut setpoints = flown.into_values();
        infer(&mut setpoints, &flight.inferred);
        replica.replace_setpoints(setpoints);
        replica
    }

    /// Flies one airborne span, and writes its readings to `replica` and the setpoints as corrected
    /// to `setpoints`.
    fn fly_span(
        &self,
        flight: &PreparedFlight,
        span: std::ops::Range<f64>,
        seed: u64,
        setpoints: &mut Stream<AttitudeSetpoint>,
        replica: &mut PreparedFlight,
    ) {
        let steps_per_second = (1.0 / Plant::STEP).round();
        // On whole milliseconds the loop's ticks and most stamps coincide with steps.
        let first = (span.start * steps_per_second).ceil();
        let time_of = |k: usize| (first + k as f64) * Plant::STEP;
        let steps = ((span.end * steps_per_second).floor() - first).max(0.0) as usize;
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut sensors = Sensors::new(&self.config, &self.effects, rng.random());
        let mut plant = self.plant.clone();
        let start = time_of(0);
        self.place_plant(flight, start, &mut plant);

        let mut recorder = Recorder::new(flight, start);
        let mut queue = SetpointQueue::new(setpoints, start - self.command_delay);
        let mut commands: Vec<[f64; ROTORS]> = Vec::with_capacity(steps);
        let delay = (self.output_delay.max(0.0) / Plant::STEP).round() as usize;
        let mut voltage = flight.voltage.cursor();
        let mut command = flight.outputs.at(start);
        let mut last_tick = f64::NEG_INFINITY;
        for k in 0..steps {
            let time = time_of(k);
            if flight.channels.voltage && k % 20 == 0 {
                plant.hold_voltage(voltage.at(time)[0]);
            }
            sensors.record(&plant);
            let ticks = self.law.tick(time) > last_tick;
            let readings =
                (ticks || recorder.is_due(replica, time)).then(|| sensors.sample(&plant));
            while let Some((index, sent)) = queue.sent(setpoints, time) {
                self.correct(&mut setpoints.values_mut()[index], flight, time, plant.state());
                queue.send(index, sent, self.command_delay, &mut rng);
            }
            if let Some(readings) = readings.as_ref().filter(|_| ticks) {
                last_tick = self.law.tick(time);
                let in_force = queue.in_force(time).filter(|index| {
                    time - setpoints.times()[*index] < self.command_delay + AGE_MAX_S
                });
                let attitude = readings.onboard_attitude.euler();
                command = match in_force.and_then(|index| as_onboard(&setpoints.values()[index])) {
                    Some(setpoint) => {
                        self.attitude_loop.outputs(&setpoint, attitude, readings.gyro)
                    }
                    None => flight.outputs.at(time),
                };
            }
            let reported = if self.law.reports_first() {
                commands.last().copied().unwrap_or(command)
            } else {
                command
            };
            commands.push(command);
            if let Some(readings) = &readings {
                recorder.write(replica, time, readings, &plant, reported);
            }
            plant.step(commands[k.saturating_sub(delay)]);
        }
    }

    /// Puts the plant at the flight's state, with its rotors driven by the logged outputs.
    fn place_plant(&self, flight: &PreparedFlight, start: f64, plant: &mut Plant) {
        let mut outputs = flight.outputs.cursor();
        let steps = (WARM_UP_S / Plant::STEP).round() as usize;
        let time = |k: usize| start - WARM_UP_S + (k as f64 + 0.5) * Plant::STEP;
        plant.set_rotor_states(outputs.at(time(0) - self.output_delay));
        if flight.channels.voltage {
            plant.hold_voltage(flight.voltage.at(start)[0]);
        }
        for k in 0..steps {
            plant.step(outputs.at(time(k) - self.output_delay));
        }
        plant.set_state(self.course(flight, start));
    }

    /// The flight's state at `time`: position and velocity as reported and smoothed, with the
    /// vehicle's latency and trim removed.
    fn course(&self, flight: &PreparedFlight, time: f64) -> State {
        let seen = time + self.latency;
        let smoothed = |series: &Series<3>| series.mean_about(seen, COURSE_SMOOTHING_S);
        State {
            position: smoothed(&flight.position).into(),
            velocity: smoothed(&flight.velocity).into(),
            attitude: flight.attitude.attitude_at(seen).compose(self.untrim),
            body_rate: flight.body_rate.at(time).into(),
        }
    }

    /// Acceleration back to the course, north, east, down, m/s^2.
    fn restoring_acceleration(&self, desired: &State, state: &State) -> Ned {
        let acceleration = (desired.position - state.position) * COURSE_RAD_S.powi(2)
            + (desired.velocity - state.velocity) * (2.0 * COURSE_RAD_S);
        let norm = acceleration.norm();
        if norm > COURSE_MAX { acceleration * (COURSE_MAX / norm) } else { acceleration }
    }

    /// Changes of pitch and roll (rad) and of collective thrust (N) for an acceleration.
    fn tilt(&self, acceleration: Ned, heading: f64) -> [f64; 3] {
        let [north, east, down] = acceleration.to_array();
        let (sin, cos) = heading.sin_cos();
        let (front, right) = (cos * north + sin * east, cos * east - sin * north);
        [-front / self.gravity, right / self.gravity, -down * self.mass]
    }

    /// Corrects a setpoint sent at `time` towards the course.
    fn correct(
        &self,
        setpoint: &mut AttitudeSetpoint,
        flight: &PreparedFlight,
        time: f64,
        state: &State,
    ) {
        let desired = self.course(flight, time);
        let [pitch, roll, lift] =
            self.tilt(self.restoring_acceleration(&desired, state), state.attitude.yaw());
        if let Some(thrust) = &mut setpoint.thrust {
            let most = self.law.allocation().collective_max();
            *thrust = (*thrust + lift / most).clamp(0.0, 1.0);
        }
        if let Some(attitude) = &mut setpoint.attitude {
            let Euler { roll: r, pitch: p, yaw } = attitude.euler();
            *attitude = Euler { roll: r + roll, pitch: p + pitch, yaw }.attitude();
        } else if let Some(rate) = &mut setpoint.body_rate {
            let (is, to) = (state.attitude.euler(), desired.attitude.euler());
            *rate += Frd::new(
                to.roll + roll - is.roll,
                to.pitch + pitch - is.pitch,
                wrap_angle(to.yaw - is.yaw),
            ) * RATE_GAIN;
        }
    }
}

/// The setpoints under way and the one in force.
struct SetpointQueue {
    /// Index of the next setpoint to send.
    next: usize,
    /// Arrival times and indices of the sent ones.
    under_way: Vec<(f64, usize)>,
    /// Index of the newest that has arrived.
    in_force: Option<usize>,
}

impl SetpointQueue {
    /// The queue of setpoints from the one in force at `from`, s.
    fn new(setpoints: &Stream<AttitudeSetpoint>, from: f64) -> Self {
        let next = setpoints.index_at(from).unwrap_or(0);
        Self { next, under_way: Vec::new(), in_force: None }
    }

    /// Index and time of the next setpoint, if it is sent by `time`.
    fn sent(&mut self, setpoints: &Stream<AttitudeSetpoint>, time: f64) -> Option<(usize, f64)> {
        let sent = *setpoints.times().get(self.next)?;
        (sent <= time).then_some((self.next, sent))
    }

    /// Sends a setpoint over a link of mean delay `delay`, s, with exponential jitter.
    fn send(&mut self, index: usize, sent: f64, delay: f64, rng: &mut Pcg64Mcg) {
        let jitter: f64 = Exp1.sample(rng);
        let constant = (delay - JITTER_MEAN_S).max(0.0);
        let arrives = sent + constant + JITTER_MEAN_S * jitter;
        self.under_way.push((arrives, index));
        self.next = index + 1;
    }

    /// The newest setpoint that has arrived by `time`.
    fn in_force(&mut self, time: f64) -> Option<usize> {
        let in_force = &mut self.in_force;
        self.under_way.retain(|(arrives, index)| {
            let is_here = *arrives <= time;
            if is_here {
                *in_force = (*in_force).max(Some(*index));
            }
            !is_here
        });
        self.in_force
    }
}

/// Writes readings at the stamps of a log: the index of the next sample of each series.
struct Recorder {
    position: usize,
    velocity: usize,
    attitude: usize,
    body_rate: usize,
    specific_force: usize,
    outputs: usize,
}

impl Recorder {
    fn new(flight: &PreparedFlight, start: f64) -> Self {
        fn first<const N: usize>(series: &Series<N>, start: f64) -> usize {
            series.times().partition_point(|t| *t < start - 0.5 * Plant::STEP)
        }
        Self {
            position: first(&flight.position, start),
            velocity: first(&flight.velocity, start),
            attitude: first(&flight.attitude, start),
            body_rate: first(&flight.body_rate, start),
            specific_force: first(&flight.specific_force, start),
            outputs: first(&flight.outputs, start),
        }
    }

    /// Whether the step at `time` is the nearest to any stamp.
    fn is_due(&self, replica: &PreparedFlight, time: f64) -> bool {
        fn due<const N: usize>(series: &Series<N>, next: usize, time: f64) -> bool {
            series.times().get(next).is_some_and(|stamp| *stamp < time + 0.5 * Plant::STEP)
        }
        due(&replica.position, self.position, time)
            || due(&replica.velocity, self.velocity, time)
            || due(&replica.attitude, self.attitude, time)
            || due(&replica.body_rate, self.body_rate, time)
            || due(&replica.specific_force, self.specific_force, time)
            || due(&replica.outputs, self.outputs, time)
    }

    /// Writes the readings of `time` to the stamps around it.
    fn write(
        &mut self,
        replica: &mut PreparedFlight,
        time: f64,
        readings: &Readings,
        plant: &Plant,
        command: [f64; ROTORS],
    ) {
        let State { position, velocity, attitude, .. } = readings.estimate;
        let acceleration = plant.acceleration();
        let rate = readings.gyro;
        put(&mut replica.position, &mut self.position, time, |dt| {
            (position + velocity * dt).to_array()
        });
        put(&mut replica.velocity, &mut self.velocity, time, |dt| {
            (velocity + acceleration * dt).to_array()
        });
        let mut last =
            self.attitude.checked_sub(1).and_then(|i| replica.attitude.values().get(i).copied());
        put(&mut replica.attitude, &mut self.attitude, time, |dt| {
            let [x, y, z] = (rate * (0.5 * dt)).to_array();
            let Attitude { w, x, y, z } =
                attitude.compose(Attitude { w: 1.0, x, y, z }.normalized());
            let q = next_to(last, [w, x, y, z]);
            last = Some(q);
            q
        });
        put(&mut replica.body_rate, &mut self.body_rate, time, |_| rate.to_array());
        put(&mut replica.specific_force, &mut self.specific_force, time, |_| {
            readings.specific_force.to_array()
        });
        put(&mut replica.outputs, &mut self.outputs, time, |_| command);
    }
}

/// Sets the samples whose stamps are nearest to `time`. `value` receives the time from `time` to
/// the stamp, s.
fn put<const N: usize>(
    series: &mut Series<N>,
    next: &mut usize,
    time: f64,
    mut value: impl FnMut(f64) -> [f64; N],
) {
    while let Some(stamp) = series.times().get(*next).copied()
        && stamp < time + 0.5 * Plant::STEP
    {
        if let Some(slot) = series.values_mut().get_mut(*next) {
            *slot = value(stamp - time);
        }
        *next += 1;
    }
}
