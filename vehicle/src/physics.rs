//! The equations of motion: the nominal vehicle with effects, from rotor states to accelerations,
//! generic over the scalar.
//!
//! The plant integrates them; the planner and the regulator take their Jacobians with dual numbers.
//! The nominal vehicle is a rigid body with thrust along -z body and a drag torque at each rotor.
//! Aerodynamics and a dependence on voltage come from effects only.

mod aerodynamics;
mod body_laws;
mod constants;
mod loads;
mod wiring;

pub use body_laws::BodyLaws;
pub(crate) use body_laws::Lawless;
pub use constants::{Constants, RotorConstants};
pub use loads::{Environment, Loads};

use self::aerodynamics::Aerodynamics;
use self::wiring::FlowEffects;
use crate::effects::{
    BatterySag, Effect, EffectId, EffectSet, RotorDrag, RotorGyroscopic, ThrustCurve, Wind, Wrench,
};
use crate::frame::{Frd, Ned};
use crate::law::{Laws, Needed, QUANTITIES, Quantity};
use crate::params::{ROTORS, VehicleError, VehicleParams};
use crate::rigid_body::{RigidBody, State};
use crate::rotor::Allocation;
use crate::scalar::Scalar;

/// A vehicle with effects, ready to evaluate.
#[derive(Clone, Copy, Debug)]
pub struct Physics<L = Option<Laws>> {
    body: RigidBody,
    constants: Constants,
    allocation: Allocation,
    curve: Option<ThrustCurve>,
    sag: Option<BatterySag>,
    wind: Ned,
    aerodynamics: Option<Aerodynamics>,
    laws: L,
    /// Angular momentum along down of rotor i at full speed, N m s, if modelled.
    spin_momentum_max: Option<[f64; ROTORS]>,
    needs_rotor_speed: bool,
    /// 1 / (ROTORS n_hover).
    speed_ratio_scale: f64,
    air_density: f64,
    inverse_induced_velocity: f64,
    full_voltage: f64,
}

impl Physics {
    /// The vehicle with its modelled effects, and with those of `overlay` added or replacing them.
    /// `linear_drag_N_per_m_s` replaces rotor_drag, unless `overlay` has a rotor_drag: that
    /// replaces both.
    ///
    /// # Errors
    /// The vehicle's mixer cannot be inverted, or the vehicle lacks a number that an effect needs.
    pub fn new(vehicle: &VehicleParams, overlay: &EffectSet) -> Result<Self, VehicleError> {
        let effects = &vehicle.modelled_effects.overlay(overlay);
        vehicle.check_effects(effects)?;
        let mut constants = Constants::nominal(vehicle);
        constants.apply_all(effects);
        constants.motor_time_constant += effects.laws().iter().map(|law| law.lag_s()).sum::<f64>();

        let linear_drag =
            vehicle.linear_drag_n_per_m_s.filter(|_| !overlay.contains(RotorDrag::ID));
        let mut flow = FlowEffects::of(effects);
        if linear_drag.is_some() {
            flow.rotor_drag = None;
        }
        let aerodynamics = Aerodynamics {
            effects: flow,
            linear_drag,
            angular_damping: vehicle.angular_damping_nms,
        };
        let spin_momentum_max = effects.get::<RotorGyroscopic>().zip(vehicle.rotor_max_rpm).map(
            |(RotorGyroscopic { rotor_inertia_kgm2 }, max_rpm)| {
                let max_speed = max_rpm * std::f64::consts::TAU / 60.0;
                constants.rotors.map(|rotor| -rotor_inertia_kgm2 * rotor.spin * max_speed)
            },
        );
        let disc = std::f64::consts::PI * vehicle.rotor_radius_m * vehicle.rotor_radius_m;
        let weight = vehicle.mass * vehicle.gravity;
        let arms = constants.rotors.iter().map(|rotor| rotor.x.hypot(rotor.y));
        let arm = arms.fold(0.0, f64::max);
        let laws = Laws::new(effects.laws(), weight, arm, vehicle.battery.full_v);
        let is_turned = laws.as_ref().is_some_and(|laws| laws.reads(Quantity::RotorSpeed));
        Ok(Self {
            body: RigidBody::new(constants.mass, constants.inertia, vehicle.gravity),
            constants,
            allocation: vehicle.allocation()?,
            curve: effects.get(),
            sag: effects.get(),
            wind: effects.get::<Wind>().map_or(Ned::zero(), |wind| wind.velocity),
            aerodynamics: (!aerodynamics.is_empty()).then_some(aerodynamics),
            needs_rotor_speed: flow.read_rotor_speed() || spin_momentum_max.is_some() || is_turned,
            laws,
            spin_momentum_max,
            speed_ratio_scale: 1.0 / (ROTORS as f64 * vehicle.hover_thrust.sqrt()),
            air_density: vehicle.air_density,
            inverse_induced_velocity: (2.0 * vehicle.air_density * 4.0 * disc / weight).sqrt(),
            full_voltage: vehicle.battery.full_v,
        })
    }

    /// Mass, inertia and gravity, effects included.
    pub fn body(&self) -> &RigidBody {
        &self.body
    }

    /// The vehicle's constants, effects included.
    pub fn constants(&self) -> &Constants {
        &self.constants
    }

    /// The firmware's mixer, which is always the nominal one.
    pub fn allocation(&self) -> &Allocation {
        &self.allocation
    }

    /// The steady wind in world axes, m/s.
    pub fn wind(&self) -> Ned {
        self.wind
    }

    /// Whether the vehicle has aerodynamic effects, linear drag, angular damping or laws.
    fn has_aerodynamics(&self) -> bool {
        self.aerodynamics.is_some() || self.laws.is_some()
    }

    /// A remark if wind or gusts in `effects` do nothing to this vehicle, which was made with them:
    /// moving air acts only through aerodynamics.
    pub fn unfelt(&self, effects: &EffectSet) -> Option<String> {
        let moves_air = |id: &EffectId| matches!(id, EffectId::Wind | EffectId::Gusts);
        let unfelt: Vec<&str> =
            effects.iter().map(|(id, _)| id).filter(moves_air).map(EffectId::name).collect();
        (!unfelt.is_empty() && !self.has_aerodynamics()).then(|| {
            format!(
                "{} does nothing to this vehicle, which has no drag: add rotor_drag or \
                 parasitic_drag",
                unfelt.join(" and ")
            )
        })
    }

    /// Whether the pack's voltage acts on the rotors or the body.
    pub fn depends_on_voltage(&self) -> bool {
        let is_read = |laws: &Laws| laws.reads(Quantity::Voltage) || laws.reads(Quantity::Charge);
        self.sag.is_some() || self.laws.as_ref().is_some_and(is_read)
    }

    /// Whether thrust, linear in the outputs, is all that acts on the body: no aerodynamics, laws,
    /// angular momentum of the rotors or thrust curve.
    pub(crate) fn is_bare(&self) -> bool {
        self.aerodynamics.is_none()
            && self.laws.is_none()
            && !self.needs_rotor_speed
            && self.curve.is_none()
    }

    /// The same physics with other laws.
    #[inline(always)]
    fn under<M>(&self, laws: M) -> Physics<M> {
        Physics {
            laws,
            body: self.body,
            constants: self.constants,
            allocation: self.allocation,
            curve: self.curve,
            sag: self.sag,
            wind: self.wind,
            aerodynamics: self.aerodynamics,
            spin_momentum_max: self.spin_momentum_max,
            needs_rotor_speed: self.needs_rotor_speed,
            speed_ratio_scale: self.speed_ratio_scale,
            air_density: self.air_density,
            inverse_induced_velocity: self.inverse_induced_velocity,
            full_voltage: self.full_voltage,
        }
    }

    /// The physics of a vehicle that [is bare](Self::is_bare), in a form that lets the compiler
    /// remove the unused terms.
    #[inline(always)]
    pub(crate) fn bare(&self) -> Physics<Lawless> {
        Physics {
            aerodynamics: None,
            spin_momentum_max: None,
            needs_rotor_speed: false,
            curve: None,
            ..self.under(Lawless)
        }
    }

    /// The same physics without laws, with every effect present and inactive ones neutral. It has
    /// no branch on which effects act; such a branch would prevent vectorisation.
    #[inline(always)]
    pub(crate) fn dense(&self) -> Physics<Lawless> {
        self.dense_under(Lawless)
    }

    #[inline(always)]
    fn dense_under<M>(&self, laws: M) -> Physics<M> {
        let aerodynamics = self.aerodynamics.unwrap_or_default().dense();
        Physics {
            aerodynamics: Some(aerodynamics),
            spin_momentum_max: Some(self.spin_momentum_max.unwrap_or_default()),
            needs_rotor_speed: true,
            curve: Some(self.curve.unwrap_or(Effect::neutral())),
            ..self.under(laws)
        }
    }

    /// [Dense](Self::dense) physics with the laws, each of which is an interpreted program; `None`
    /// without laws.
    #[inline(always)]
    pub(crate) fn lawful(&self) -> Option<Physics<&Laws>> {
        Some(self.dense_under(self.laws.as_ref()?))
    }

    /// The steady wind plus `gust` (m/s), the pack at terminal voltage `voltage` (V), the floor at
    /// 0.
    pub fn environment(&self, voltage: f64, gust: Ned) -> Environment {
        Environment {
            air_velocity: self.wind + gust,
            voltage_factor: self.voltage_factor(voltage),
            floor: 0.0,
            voltage,
            time: 0.0,
        }
    }

    /// The steady wind without gusts, a full pack, the floor at 0.
    pub fn calm(&self) -> Environment {
        self.environment(self.full_voltage, Ned::zero())
    }

    /// Factor on thrust and squared rotor speed at terminal voltage `voltage` (V).
    pub fn voltage_factor(&self, voltage: f64) -> f64 {
        self.sag.map_or(1.0, |sag| sag.factor(voltage / self.full_voltage))
    }

    /// The quantities that laws refer to, computed where `needed`.
    pub fn quantities(
        &self,
        needed: Needed,
        state: &State,
        loads: &Loads<f64>,
        env: &Environment,
    ) -> [f64; QUANTITIES] {
        let rotors = loads.as_quantities();
        crate::law::values(needed, state, &rotors, env, self.full_voltage)
    }

    /// Acceleration in world axes (m/s^2) and angular acceleration in body axes (rad/s^2) with the
    /// rotors held in states s_i.
    #[inline(always)]
    pub fn accelerations<T: Scalar>(
        &self,
        state: &State<T>,
        rotors: &[T; ROTORS],
        env: &Environment,
    ) -> (Ned<T>, Frd<T>) {
        self.accelerations_under(state, &self.loads(rotors, env), env)
    }

    /// As [`Physics::accelerations`], after the rotors have settled at the outputs that the
    /// firmware gives for a commanded collective (N) and moments (N m), unclipped above. A model
    /// for control about hover, without lag or upper saturation.
    ///
    /// The mean rotor speed is linear in the thrust, as about hover: `(1 + T / T_hover) / 2`.
    /// Thrust grows with the square of the speed, so commands that alternate from period to period
    /// would turn the rotors more slowly, and reduce their drag. Rotors that lag do not follow, but
    /// a plan would use it.
    pub fn accelerations_for_wrench<T: Scalar>(
        &self,
        state: &State<T>,
        wrench: &[T; 4],
        env: &Environment,
    ) -> (Ned<T>, Frd<T>) {
        let rotors = self.rotors_for_wrench(wrench);
        let mut loads = self.thrust_loads(&rotors, env);
        if self.needs_rotor_speed {
            let [a, b, c, d] = rotors.map(|s| self.fraction(s, env));
            let inverse_hover = ROTORS as f64 * self.speed_ratio_scale * self.speed_ratio_scale;
            loads.rotor_speed_ratio = ((a + b + c + d) * inverse_hover + 1.0) * 0.5;
        }
        if self.spin_momentum_max.is_some() {
            loads.spin_momentum = self.spin_momentum(self.rotor_speeds(&rotors, env));
        }
        self.accelerations_under(state, &loads, env)
    }

    /// The rotor states for a commanded collective (N) and moments (N m); at least 0, unclipped
    /// above.
    pub fn rotors_for_wrench<T: Scalar>(&self, wrench: &[T; 4]) -> [T; ROTORS] {
        let inverse = self.allocation.inverse();
        std::array::from_fn(|i| {
            let [a, b, c, d] = inverse[i];
            let thrust = wrench[0] * a + wrench[1] * b + wrench[2] * c + wrench[3] * d;
            (thrust * (1.0 / self.allocation.thrust_max()[i])).max(T::default())
        })
    }

    /// The commanded collective (N) that, shared evenly, balances the weight at rest in calm air
    /// far from the floor. It is m g for the nominal vehicle and differs with effects on the
    /// thrust.
    ///
    /// Returns `None` if full output does not balance the weight.
    pub fn hover_collective(&self, env: &Environment) -> Option<f64> {
        let weight_n = self.body.mass() * self.body.gravity();
        let even = |collective: f64| -> f64 {
            self.thrusts(&self.rotors_for_wrench(&[collective, 0.0, 0.0, 0.0]), env).iter().sum()
        };
        let (mut low, mut high) = (0.0, self.allocation.collective_max());
        if even(high) < weight_n {
            return None;
        }
        // Thrust grows with the collective for every accepted curve; 60 bisections reach rounding.
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if even(middle) < weight_n { low = middle } else { high = middle }
        }
        Some(0.5 * (low + high))
    }
}

/// Evaluation, generic over the laws.
impl<L: BodyLaws> Physics<L> {
    /// Whether the rotors' angular momentum acts on the body.
    pub fn has_spin_momentum(&self) -> bool {
        self.spin_momentum_max.is_some()
    }

    /// Thrust of a rotor over `thrust_max` at state `s`, which is also its squared speed over the
    /// squared maximum.
    #[inline(always)]
    fn fraction<T: Scalar>(&self, s: T, env: &Environment) -> T {
        let bent = match &self.curve {
            Some(curve) => curve.fraction(s),
            None => s,
        };
        bent * env.voltage_factor
    }

    /// Thrust of each rotor before aerodynamic factors, N.
    #[inline(always)]
    pub fn thrusts<T: Scalar>(&self, rotors: &[T; ROTORS], env: &Environment) -> [T; ROTORS] {
        std::array::from_fn(|i| self.fraction(rotors[i], env) * self.constants.rotors[i].thrust_max)
    }

    /// n_i: speed of each rotor as a fraction of the maximum.
    #[inline(always)]
    pub fn rotor_speeds<T: Scalar>(&self, rotors: &[T; ROTORS], env: &Environment) -> [T; ROTORS] {
        std::array::from_fn(|i| root(self.fraction(rotors[i], env)))
    }

    /// Angular momentum along down of rotors at these speeds, N m s.
    #[inline(always)]
    fn spin_momentum<T: Scalar>(&self, speeds: [T; ROTORS]) -> T {
        let mut sum = T::default();
        if let Some(momenta) = &self.spin_momentum_max {
            for (momentum, speed) in momenta.iter().zip(speeds) {
                sum += speed * *momentum;
            }
        }
        sum
    }

    /// The loads of rotors in states s_i, with constant angular momentum.
    #[inline(always)]
    pub fn loads<T: Scalar>(&self, rotors: &[T; ROTORS], env: &Environment) -> Loads<T> {
        let mut loads = self.thrust_loads(rotors, env);
        if self.needs_rotor_speed {
            let speeds = self.rotor_speeds(rotors, env);
            let [a, b, c, d] = speeds;
            loads.rotor_speed_ratio = (a + b + c + d) * self.speed_ratio_scale;
            loads.spin_momentum = self.spin_momentum(speeds);
        }
        loads
    }

    /// The loads of the thrusts and drag torques alone.
    #[inline(always)]
    fn thrust_loads<T: Scalar>(&self, rotors: &[T; ROTORS], env: &Environment) -> Loads<T> {
        let mut loads = Loads {
            thrust: T::default(),
            moment: [T::default(); 3],
            rotor_speed_ratio: T::default(),
            spin_momentum: T::default(),
            spin_momentum_rate: T::default(),
        };
        let thrusts = self.thrusts(rotors, env);
        for (rotor, thrust) in self.constants.rotors.iter().zip(thrusts) {
            loads.thrust += thrust;
            loads.moment[0] += thrust * -rotor.y;
            loads.moment[1] += thrust * rotor.x;
            loads.moment[2] += thrust * rotor.torque_per_thrust;
        }
        loads
    }

    /// Loads at the start, middle and end of a step of `step` seconds, given the loads of rotors
    /// held at these instants. Each gets the slope dh/dt of the parabola through the three. The
    /// body then receives exactly the angular momentum that the rotors gain, even from rest, where
    /// the true dh/dt is infinite.
    #[inline(always)]
    pub fn lagged_loads<T: Scalar>(&self, loads: [Loads<T>; 3], step: f64) -> [Loads<T>; 3] {
        if !self.has_spin_momentum() {
            return loads;
        }
        let [h0, h1, h2] = loads.each_ref().map(Loads::spin_momentum);
        let rates = [h1 * 4.0 - h0 * 3.0 - h2, h2 - h0, h0 - h1 * 4.0 + h2 * 3.0];
        std::array::from_fn(|i| loads[i].with_spin_momentum_rate(rates[i] / T::from(step)))
    }

    /// Loads of rotors without lag: those `after` the change, throughout the step.
    #[inline(always)]
    pub fn sudden_loads<T: Scalar>(
        &self,
        before: Loads<T>,
        after: Loads<T>,
        step: f64,
    ) -> [Loads<T>; 3] {
        let rate = (after.spin_momentum - before.spin_momentum) / T::from(step);
        [after.with_spin_momentum_rate(rate); 3]
    }

    /// Force without gravity (N) and moment (N m) on the body, body axes.
    #[inline(always)]
    pub fn wrench<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
    ) -> Wrench<T> {
        let zero = T::default();
        let [roll, pitch, yaw] = loads.moment;
        let mut wrench = Wrench {
            force: Frd::new(zero, zero, -loads.thrust),
            moment: Frd::new(roll, pitch, yaw),
        };
        if let Some(aerodynamics) = &self.aerodynamics {
            self.add_aerodynamics(aerodynamics, state, loads, env, &mut wrench);
        }
        self.laws.add(state, loads, env, &mut wrench);
        if self.spin_momentum_max.is_some() {
            let [p, q, _] = state.body_rate.to_array();
            let h = loads.spin_momentum;
            wrench.moment += Frd::new(-(q * h), p * h, -loads.spin_momentum_rate);
        }
        wrench
    }

    /// Acceleration in world axes (m/s^2) and angular acceleration in body axes (rad/s^2) under the
    /// given loads.
    #[inline(always)]
    pub fn accelerations_under<T: Scalar>(
        &self,
        state: &State<T>,
        loads: &Loads<T>,
        env: &Environment,
    ) -> (Ned<T>, Frd<T>) {
        let wrench = self.wrench(state, loads, env);
        self.body.accelerations(state, wrench.force, wrench.moment)
    }
}

/// The square root of a number that is at least 0 in exact arithmetic. Its derivative at 0 is 0,
/// where the true one is infinite.
#[inline(always)]
fn root<T: Scalar>(x: T) -> T {
    if x.is_above(0.0) { x.sqrt() } else { T::default() }
}
