//! The desired states of a trajectory: those of a vehicle that follows it without drag by its own
//! motion.

use std::f64::consts::PI;

use vehicle::AttitudePd;
use vehicle::frame::{Euler, Heading, Ned};

use super::planned::{CommandedInput, PlannedBody};
use super::problem::{ANGLE, RATE, StateVector, YAW};
use super::trajectory::{DesiredPoint, Trajectory};
use crate::model::{Model, Point};

/// Desired states, and the inputs that hold them without drag.
#[derive(Clone, Debug, PartialEq)]
pub struct Desire {
    /// `s_d,0 .. s_d,N`.
    pub states: Vec<StateVector>,
    /// `u_hat_0 .. u_hat_{N-1}`.
    pub inputs: Vec<CommandedInput>,
}

/// What thrust must carry at rest, and the tilt limit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weight {
    /// kg
    pub mass_kg: f64,
    /// m/s^2
    pub gravity: f64,
    /// What else acts at rest.
    pub push: Push,
    /// Largest angle of the thrust axis to the vertical, rad.
    pub tilt_max_rad: f64,
}

/// What acts on a level vehicle at rest beside thrust and weight: a wind pushes it in the world, a
/// trim of its attitude in axes that turn with its yaw, and a centre of mass beside the middle turns
/// it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Push {
    /// North and east, m/s^2.
    pub world: [f64; 2],
    /// Front and right, m/s^2.
    pub heading: [f64; 2],
    /// Roll, pitch and yaw of the setpoint beyond the attitude's, rad: the on-board loop's moments
    /// then hold against the turn.
    pub setpoint: [f64; 3],
}

impl Push {
    /// What a model predicts for `body` under its hover thrust, and the setpoint with which the loop
    /// `pd` holds it: `zeta_des - zeta = -I alpha / kp`. The accelerations in the world and in the
    /// heading are the mean and half the difference of two opposite headings, which is exact for a
    /// wind and a trim.
    pub fn of(model: &dyn Model, body: &PlannedBody, pd: &AttitudePd) -> Self {
        let hover_n = body.mass_kg * body.gravity;
        let [one, other] = [0.0, PI].map(|yaw| {
            let attitude = Euler::new(0.0, 0.0, yaw);
            let input = [hover_n, 0.0, 0.0, 0.0];
            model.accelerations(&Point { attitude, input, ..Point::default() })
        });
        let mean = |i: usize| 0.5 * (one[i] + other[i]);
        Self {
            world: [mean(0), mean(1)],
            heading: [0.5 * (one[0] - other[0]), 0.5 * (one[1] - other[1])],
            setpoint: std::array::from_fn(|i| -body.inertia[i] * mean(3 + i) / pd.kp[i]),
        }
    }
}

impl Desire {
    /// Samples the trajectory every `period_s` from `from_s` on, for `periods` periods.
    ///
    /// A quadrotor is differentially flat: thrust carries the weight and the push and produces the
    /// acceleration, `(u1/m) R e3 = g e3 + push - a`, which with the yaw determines the attitude
    /// (Mellinger and Kumar 2011). The body rates lead from one attitude to the next.
    pub fn new(
        trajectory: &Trajectory,
        from_s: f64,
        period_s: f64,
        periods: usize,
        weight: &Weight,
    ) -> Self {
        let points = (0..periods + 1).map(|n| trajectory.sample(from_s + n as f64 * period_s));
        Self::along(points, period_s, weight)
    }

    /// The same from given points, at least two.
    pub(super) fn along(
        points: impl ExactSizeIterator<Item = DesiredPoint>,
        period_s: f64,
        weight: &Weight,
    ) -> Self {
        let periods = points.len() - 1;
        let mut thrusts = Vec::with_capacity(periods + 1);
        let mut states: Vec<StateVector> = points
            .map(|point| {
                let (thrust, attitude) = weight.carry(&point);
                thrusts.push(thrust);
                let ([n, e, d], [vn, ve, vd]) =
                    (point.position.to_array(), point.velocity.to_array());
                let Euler { roll, pitch, yaw } = attitude;
                [n, e, d, vn, ve, vd, roll, pitch, yaw, 0.0, 0.0, 0.0]
            })
            .collect();
        for n in 0..periods {
            let next = states[n + 1];
            let state = &mut states[n];
            let rates: [f64; 3] =
                std::array::from_fn(|i| (next[ANGLE + i] - state[ANGLE + i]) / period_s);
            let attitude = Euler::new(state[ANGLE], state[ANGLE + 1], state[YAW]);
            state[RATE..].copy_from_slice(&attitude.body_rate(rates).to_array());
        }
        let before = states[periods - 1];
        states[periods][RATE..].copy_from_slice(&before[RATE..]);
        let inputs = states[..periods]
            .iter()
            .zip(&thrusts)
            .map(|(state, thrust)| {
                let [.., roll, pitch, yaw, p, q, r] = *state;
                let [more_roll, more_pitch, more_yaw] = weight.push.setpoint;
                [*thrust, roll + more_roll, pitch + more_pitch, yaw + more_yaw, p, q, r]
            })
            .collect();
        Self { states, inputs }
    }
}

impl Weight {
    /// Thrust (N) and attitude that produce a point's acceleration.
    pub(crate) fn carry(&self, point: &DesiredPoint) -> (f64, Euler<f64>) {
        let Push { world: [north, east], heading, .. } = self.push;
        let carried = Ned::new(north, east, self.gravity) - point.acceleration;
        let [ahead, right, down] = Heading::new(point.yaw).to_level(carried);
        let (ahead, right) = (ahead + heading[0], right + heading[1]);
        // Beyond the largest tilt, the direction is kept and the tilt cut.
        let across = ahead.hypot(right);
        let most = self.tilt_max_rad.tan() * down.max(0.1 * self.gravity);
        let cut = if across > most { most / across } else { 1.0 };
        let (ahead, right, down) = (cut * ahead, cut * right, down.max(0.1 * self.gravity));
        let length = (ahead * ahead + right * right + down * down).sqrt();
        let roll = (-right / length).clamp(-1.0, 1.0).asin();
        let pitch = ahead.atan2(down);
        (self.mass_kg * length, Euler::new(roll, pitch, point.yaw))
    }
}

#[cfg(test)]
mod tests {
    use vehicle::VehicleParams;
    use vehicle::effects::EffectSet;

    use super::*;
    use crate::model::physics::{PhysicsModel, PhysicsParameters};

    #[test]
    fn desired_attitude_holds_against_wind_and_trim_at_every_heading() {
        let text = include_str!("../../config/vehicles/crazyflie.toml");
        let vehicle = VehicleParams::from_toml_str(text).expect("a vehicle");
        let mut effects = EffectSet::new();
        for effect in [
            "rotor_drag:d_xy=0.012,d_z=0.008",
            "wind:north_m_s=2,east_m_s=-1",
            "attitude_trim:roll_rad=0.02,pitch_rad=-0.03",
        ] {
            effects.insert_argument(effect).expect("an effect");
        }
        let physics = PhysicsParameters { effects, ..PhysicsParameters::default() };
        let model = PhysicsModel::new(&vehicle, &physics).expect("physics");
        let (mass_kg, gravity) = (vehicle.mass, vehicle.gravity);
        let body = PlannedBody {
            mass_kg,
            inertia: vehicle.inertia,
            gravity,
            thrust_full_n: vehicle.rotors.iter().map(|rotor| rotor.thrust_max_n).sum(),
        };
        let push = Push::of(&model, &body, &vehicle.attitude_pd.expect("a loop"));
        let [north, east] = push.world;
        assert!(north > 0.5 && east < -0.2 && push.heading[0].abs() > 0.2, "{push:?}");
        let weight = Weight { mass_kg, gravity, push, tilt_max_rad: 0.5 };
        for yaw in [-2.0, 0.0, 0.7, 2.9] {
            let (thrust_n, attitude) = weight.carry(&DesiredPoint { yaw, ..Default::default() });
            let input = [thrust_n, 0.0, 0.0, 0.0];
            let [north, east, ..] =
                model.accelerations(&Point { attitude, input, ..Point::default() });
            assert!(north.hypot(east) < 0.05, "{north} {east} at {yaw}");
        }
    }
}
