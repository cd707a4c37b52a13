//! The residual of the equations of motion over a cell under the vehicle file's physics, and its
//! derivatives with respect to the [columns](super::columns).

use vehicle::frame::{Attitude, Frd, Ned};
use vehicle::physics::{Environment, Physics};
use vehicle::rigid_body::State;
use vehicle::{ROTORS, VehicleError, VehicleParams};

use super::columns::*;

/// Number of equations: acceleration in world axes, specific force and angular acceleration in body
/// axes.
pub(super) const EQUATIONS: usize = 9;
pub(super) const FORCE: usize = 3;
pub(super) const RATE: usize = 6;

/// Means of the reports over a cell; `None` for what is not reported.
#[derive(Clone, Copy, Debug)]
pub(super) struct Means {
    /// Only for effects of the floor, which are the file's at this position; otherwise height has
    /// no influence.
    pub position: Ned,
    pub velocity: Ned,
    pub attitude: Attitude,
    pub body_rate: Frd,
    /// States of the rotors.
    pub rotors: [f64; ROTORS],
    pub voltage: Option<f64>,
    /// Change of velocity divided by the cell's length, m/s^2.
    pub acceleration: Option<Ned>,
    pub specific_force: Option<Frd>,
    /// Change of the body rate divided by the cell's length, rad/s^2.
    pub angular_acceleration: Option<Frd>,
}

/// One equation of a cell.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Reported minus modelled; not a number where it was not reported.
    pub residual: f64,
    /// The modelled value in excess of a hover.
    pub model: f64,
    /// Derivative of the modelled side with respect to each column, in units of its [size](Sizes).
    pub slopes: [f64; COLUMNS],
}

/// The reference physics of the cells.
#[derive(Clone, Debug)]
pub(super) struct Equations {
    physics: Physics,
    full_v: f64,
    sizes: Sizes,
}

impl Equations {
    pub fn new(vehicle: &VehicleParams) -> Result<Self, VehicleError> {
        let physics = Physics::new(vehicle, &vehicle::effects::EffectSet::new())?;
        Ok(Self { physics, full_v: vehicle.battery.full_v, sizes: Sizes::of(vehicle) })
    }

    pub fn lag_s(&self) -> f64 {
        self.physics.constants().motor_time_constant
    }

    pub fn sizes(&self) -> &Sizes {
        &self.sizes
    }

    pub fn rows(&self, means: &Means) -> [Row; EQUATIONS] {
        let physics = &self.physics;
        let environment = physics.environment(means.voltage.unwrap_or(self.full_v), Ned::zero());
        let state = State {
            position: means.position,
            velocity: means.velocity,
            attitude: means.attitude,
            body_rate: means.body_rate,
        };
        let loads = physics.loads(&means.rotors, &environment);
        let (linear, angular) = physics.accelerations_under(&state, &loads, &environment);
        let gravity = Ned::new(0.0, 0.0, physics.body().gravity());
        let attitude = means.attitude;
        let force = attitude.to_body(linear - gravity);
        let mut rows = [Row { residual: f64::NAN, model: 0.0, slopes: [0.0; COLUMNS] }; EQUATIONS];
        let reported = [
            means.acceleration.map(Ned::to_array),
            means.specific_force.map(Frd::to_array),
            means.angular_acceleration.map(Frd::to_array),
        ];
        let modelled = [linear.to_array(), force.to_array(), angular.to_array()];
        let moving = [linear.to_array(), attitude.to_body(linear).to_array(), angular.to_array()];
        for (index, row) in rows.iter_mut().enumerate() {
            let (group, axis) = (index / 3, index % 3);
            row.residual =
                reported[group].map_or(f64::NAN, |seen| seen[axis] - modelled[group][axis]);
            row.model = moving[group][axis];
        }
        self.put_slopes(&mut rows, means, force, &environment);
        rows
    }

    /// Writes the derivatives of the equations; `force` is the modelled specific force in body axes.
    fn put_slopes(
        &self,
        rows: &mut [Row; EQUATIONS],
        means: &Means,
        force: Frd,
        environment: &Environment,
    ) {
        let (physics, attitude) = (&self.physics, means.attitude);
        let mass = physics.body().mass();
        let constants = physics.constants();
        let inertia = constants.inertia;
        let mut put = |column: usize, force: Frd, moment: Frd| {
            let size = self.sizes.column(column);
            let force = force * (size / mass);
            let world = attitude.to_world(force).to_array();
            let (force, moment) = (force.to_array(), moment.to_array());
            for axis in 0..3 {
                rows[axis].slopes[column] = world[axis];
                rows[FORCE + axis].slopes[column] = force[axis];
                rows[RATE + axis].slopes[column] = moment[axis] * size / inertia[axis];
            }
        };
        let thrusts = physics.thrusts(&means.rotors, environment);
        let zero = Frd::zero();
        let up = |thrust: f64| Frd::new(0.0, 0.0, -thrust);
        for (index, (rotor, thrust)) in constants.rotors.iter().zip(thrusts).enumerate() {
            let moment =
                Frd::new(-rotor.y * thrust, rotor.x * thrust, rotor.torque_per_thrust * thrust);
            put(ROTOR + index, up(thrust), moment);
        }
        let total: f64 = thrusts.iter().sum();
        put(CENTRE, zero, Frd::new(0.0, -total, 0.0));
        put(CENTRE + 1, zero, Frd::new(total, 0.0, 0.0));
        put(YAW, zero, Frd::new(0.0, 0.0, 1.0));
        put(WIND, attitude.to_body(Ned::new(1.0, 0.0, 0.0)), zero);
        put(WIND + 1, attitude.to_body(Ned::new(0.0, 1.0, 0.0)), zero);
        let air = attitude.to_body(means.velocity - physics.wind());
        put(DRAG, Frd::new(-air.front(), -air.right(), 0.0), zero);
        put(FLAPPING, zero, Frd::new(air.right(), -air.front(), 0.0));
        let across = air.front() * air.front() + air.right() * air.right();
        put(LIFT, up(total * across), zero);
        put(SINK, Frd::new(0.0, 0.0, -air.down()), zero);
        for axis in 0..3 {
            rows[FORCE + axis].slopes[ACCELEROMETER + axis] =
                self.sizes.column(ACCELEROMETER + axis);
        }
        // A vehicle with an unreported tilt e gets the additional specific force R (e x f).
        for (place, turn) in
            [Frd::new(1.0, 0.0, 0.0), Frd::new(0.0, 1.0, 0.0)].into_iter().enumerate()
        {
            let size = self.sizes.column(TILT + place);
            let pushed = attitude.to_world(turn.cross(force) * size).to_array();
            for (row, pushed) in rows.iter_mut().zip(pushed) {
                row.slopes[TILT + place] = pushed;
            }
        }
    }
}
