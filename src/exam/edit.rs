//! Errors put into a vehicle file on purpose, which a diagnosis of the vehicle's own flights should
//! find.

use vehicle::VehicleParams;
use vehicle::effects::EffectId;

/// A wrong number, or a left-out effect.
struct Edit {
    /// Its name, as a file name.
    id: &'static str,
    /// What is wrong.
    error: &'static str,
    /// Effects of which each explains the error.
    expected: &'static [EffectId],
    /// Makes the error; `false` where the file has no such number.
    make: fn(&mut VehicleParams) -> bool,
}

/// A vehicle file with one error.
#[derive(Clone, Debug, PartialEq)]
pub struct EditedVehicle {
    /// Name of the error, as a file name.
    pub id: &'static str,
    /// What is wrong; the first has no error.
    pub error: &'static str,
    /// Effects of which each explains the error; none without one.
    pub expected: &'static [EffectId],
    /// The vehicle file.
    pub vehicle: VehicleParams,
}

/// The file without an error, and with each error that it can have.
pub fn edited(vehicle: &VehicleParams) -> Vec<EditedVehicle> {
    let of_edit = |Edit { id, error, expected, make }: &Edit| {
        let mut vehicle = vehicle.clone();
        make(&mut vehicle).then_some(EditedVehicle { id, error, expected, vehicle })
    };
    EDITS.iter().filter_map(of_edit).collect()
}

/// Scales the rotors' thrust, and with it the throttle of a hover.
fn scale_thrust(vehicle: &mut VehicleParams, by: f64) -> bool {
    vehicle.rotors.iter_mut().for_each(|rotor| rotor.thrust_max_n *= by);
    vehicle.hover_thrust /= by;
    true
}

/// Leaves out an effect that the file models.
fn leave_out(vehicle: &mut VehicleParams, effect: EffectId) -> bool {
    let had = vehicle.modelled_effects.iter().any(|(id, _)| id == effect);
    vehicle.modelled_effects.remove(effect);
    had
}

/// Shortest lag that is worth leaving out, s.
const LAG_MIN_S: f64 = 0.02;

const EDITS: [Edit; 13] = [
    Edit { id: "unchanged", error: "none", expected: &[], make: |_| true },
    Edit {
        id: "mass",
        error: "mass 20 % too low",
        expected: &[EffectId::Mass, EffectId::ThrustScale],
        make: |vehicle| {
            vehicle.mass *= 0.8;
            true
        },
    },
    Edit {
        id: "thrust",
        error: "thrust of every rotor 25 % too high",
        expected: &[EffectId::ThrustScale, EffectId::Mass, EffectId::BatterySag],
        make: |vehicle| scale_thrust(vehicle, 1.25),
    },
    Edit {
        id: "rotor",
        error: "thrust of motor 2's rotor 18 % too high",
        expected: &[EffectId::RotorLoss],
        make: |vehicle| {
            vehicle.rotors[1].thrust_max_n *= 1.18;
            true
        },
    },
    Edit {
        id: "centre",
        error: "centre of mass off by 10 % of the arm",
        expected: &[EffectId::ComOffset],
        make: |vehicle| {
            let by = 0.1 * vehicle.arm_m();
            vehicle.rotors.iter_mut().for_each(|rotor| rotor.position_m[0] += by);
            true
        },
    },
    Edit {
        id: "inertia",
        error: "inertia about front and right twice as large",
        expected: &[EffectId::Inertia],
        make: |vehicle| {
            vehicle.inertia[..2].iter_mut().for_each(|inertia| *inertia *= 2.0);
            true
        },
    },
    Edit {
        id: "yaw",
        error: "rotors' drag torque twice as large",
        expected: &[EffectId::YawTorque],
        make: |vehicle| {
            let rotors = vehicle.rotors.iter_mut();
            rotors.for_each(|rotor| rotor.drag_torque_per_thrust_m *= 2.0);
            true
        },
    },
    Edit {
        id: "lag",
        error: "no rotor lag",
        expected: &[EffectId::MotorLag, EffectId::CommandDelay],
        make: |vehicle| {
            let had = std::mem::take(&mut vehicle.motor_time_constant_s);
            had >= LAG_MIN_S
        },
    },
    Edit {
        id: "delay",
        error: "setpoints' delay 60 ms too long",
        expected: &[EffectId::CommandDelay, EffectId::MotorLag, EffectId::EstimatorLatency],
        make: |vehicle| {
            vehicle.command_delay_s += 0.06;
            true
        },
    },
    Edit {
        id: "gains",
        error: "attitude gains about front and right: kp halved, kd divided by 1.3",
        expected: &[EffectId::PdGain],
        make: |vehicle| {
            let Some(law) = &mut vehicle.attitude_pd else { return false };
            law.kp[..2].iter_mut().for_each(|gain| *gain /= 2.0);
            law.kd[..2].iter_mut().for_each(|gain| *gain /= 1.3);
            true
        },
    },
    Edit {
        id: "drag",
        error: "no rotor drag",
        expected: &[EffectId::RotorDrag, EffectId::ParasiticDrag],
        make: |vehicle| {
            let linear = vehicle.linear_drag_n_per_m_s.take();
            leave_out(vehicle, EffectId::RotorDrag) || linear.is_some()
        },
    },
    Edit {
        id: "sag",
        error: "no battery sag",
        expected: &[
            EffectId::BatterySag,
            EffectId::ThrustScale,
            EffectId::Mass,
            EffectId::ThrustCurve,
        ],
        make: |vehicle| leave_out(vehicle, EffectId::BatterySag),
    },
    Edit {
        id: "flapping",
        error: "no blade flapping",
        expected: &[EffectId::BladeFlapping],
        make: |vehicle| leave_out(vehicle, EffectId::BladeFlapping),
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    fn vehicle() -> VehicleParams {
        VehicleParams::from_toml_str(include_str!("../../config/vehicles/crazyflie.toml"))
            .expect("a vehicle file")
    }

    #[test]
    fn each_error_is_of_its_own_and_leaves_a_valid_file() {
        let edited = edited(&vehicle());
        assert_eq!(edited[0].vehicle, vehicle());
        for (i, one) in edited.iter().enumerate() {
            let others = &edited[i + 1..];
            assert!(others.iter().all(|other| other.id != one.id && other.vehicle != one.vehicle));
            assert_eq!(one.expected.is_empty(), i == 0, "{}", one.id);
            let text = serde_json::to_string(&one.vehicle).expect("JSON");
            VehicleParams::from_json_str(&text)
                .unwrap_or_else(|error| panic!("{}: {error}", one.id));
        }
    }

    #[test]
    fn effects_that_the_file_lacks_are_not_left_out() {
        let bare = edited(&vehicle());
        assert!(bare.iter().all(|one| one.id != "sag"));
        let mut modelled = vehicle();
        modelled.modelled_effects =
            serde_json::from_str(r#"{"battery_sag": {"exponent": 1.3}}"#).expect("effects");
        let sag = edited(&modelled).into_iter().find(|one| one.id == "sag").expect("the sag");
        assert!(sag.vehicle.modelled_effects.is_empty());
    }
}
