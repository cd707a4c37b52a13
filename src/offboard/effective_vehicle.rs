//! The vehicle of a vehicle file with its modelled effects applied. Feedback, limits and
//! feed-forward are made with it.

use vehicle::effects::{CommandDelay, EffectSet, PdGain, RotorDrag, ThrustCurve};
use vehicle::physics::Physics;
use vehicle::{AttitudePd, VehicleError, VehicleParams};

use crate::control::{Actuation, HoverVehicle};
use crate::link::attitude_target::{ThrustMap, ThrustMapError};
use crate::plan::planned::PlannedBody;

/// Why the vehicle of a file cannot be controlled.
#[derive(Debug, thiserror::Error)]
pub enum Uncontrollable {
    /// The physics model rejects its parameters.
    #[error(transparent)]
    Vehicle(#[from] VehicleError),
    /// No thrust map exists for its motors.
    #[error(transparent)]
    Thrust(#[from] ThrustMapError),
}

/// The vehicle as its file describes it.
#[derive(Clone, Copy, Debug)]
pub struct EffectiveVehicle {
    /// Mass, inertia and gravity.
    pub hover: HoverVehicle,
    /// Drag per speed, kg/s: along front and right, and along down.
    pub drag_kg_s: [f64; 2],
    /// Thrust of all rotors at full output, N.
    pub thrust_full_n: f64,
    /// Maps thrust to the value that is sent.
    pub thrust: ThrustMap,
    /// The on-board attitude loop as a PD law, where the file describes it in either form.
    pub attitude_pd: Option<AttitudePd>,
    /// Whether that law is the whole loop, so that the vehicle may honour attitude, body rates and
    /// thrust together.
    pub is_pd: bool,
    /// Delay and lag between a setpoint and its effect.
    pub actuation: Actuation,
}

impl EffectiveVehicle {
    /// Applies the modelled effects of `params`.
    ///
    /// # Errors
    /// [`Uncontrollable`].
    pub fn new(params: &VehicleParams) -> Result<Self, Uncontrollable> {
        let physics = Physics::new(params, &EffectSet::new())?;
        let constants = physics.constants();
        let thrust_full_n = constants.rotors.iter().map(|rotor| rotor.thrust_max).sum();
        let gain = params.modelled_effects.get::<PdGain>();
        let attitude_pd =
            params.attitude_loop_pd().map(|pd| gain.map_or(pd, |gain| gain.apply(&pd)));
        // A known mixer is linear, so the motors' thrust curve shows. An autopilot's own loop is
        // assumed to linearise it.
        let bend =
            params.modelled_effects.get::<ThrustCurve>().filter(|_| params.attitude_pd.is_some());
        let thrust = ThrustMap::curve(thrust_full_n, bend.map_or(0.0, |curve| curve.a))?;
        let delay = params.modelled_effects.get::<CommandDelay>();
        let drag = params.modelled_effects.get::<RotorDrag>();
        Ok(Self {
            drag_kg_s: drag.map_or([0.0; 2], |drag| [drag.d_xy, drag.d_z]),
            hover: HoverVehicle {
                mass_kg: constants.mass,
                inertia: constants.inertia,
                gravity: params.gravity,
            },
            thrust_full_n,
            thrust,
            attitude_pd,
            is_pd: params.attitude_pd.is_some(),
            actuation: Actuation {
                command_delay_s: delay.map_or(params.command_delay_s, |delay| delay.delay_s),
                motor_time_constant_s: constants.motor_time_constant,
            },
        })
    }

    /// What a plan records about its vehicle.
    pub fn body(&self) -> PlannedBody {
        let HoverVehicle { mass_kg, inertia, gravity } = self.hover;
        PlannedBody { mass_kg, inertia, gravity, thrust_full_n: self.thrust_full_n }
    }
}
