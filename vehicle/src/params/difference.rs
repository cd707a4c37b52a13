//! The first difference between two vehicles.

use serde::Serialize;
use serde_json::Value;

use super::VehicleParams;

/// The first difference between two vehicles.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{field}{place} is {other}{} there and {this}{} in this vehicle",
    unit(.field),
    unit(.field)
)]
pub struct Difference {
    /// The field's name in vehicle files.
    pub field: &'static str,
    /// Place within the field, such as `[2].spin` in the list of rotors; empty for a single value.
    pub place: String,
    /// The value in this vehicle, formatted as JSON.
    pub this: String,
    /// The value in the other vehicle, formatted as JSON.
    pub other: String,
}

impl Difference {
    fn of<T: PartialEq + Serialize>(field: &'static str, this: &T, other: &T) -> Option<Self> {
        if this == other {
            return None;
        }
        let text = |value: &T| match serde_json::to_value(value) {
            Ok(value) => value,
            Err(error) => format!("a value that no file can hold ({error})").into(),
        };
        let (this, other) = (text(this), text(other));
        let (place, this, other) = first_difference(&this, &other);
        Some(Self { field, place, this: this.to_string(), other: other.to_string() })
    }

    /// Compares an optional field, if both vehicles have it.
    fn of_both<T: PartialEq + Serialize>(
        field: &'static str,
        this: &Option<T>,
        other: &Option<T>,
    ) -> Option<Self> {
        Self::of(field, this.as_ref()?, other.as_ref()?)
    }
}

/// The unit of a field whose name states none, after a space.
fn unit(field: &str) -> &'static str {
    match field {
        "mass" => " kg",
        "inertia" => " kg m^2",
        "gravity" => " m/s^2",
        _ => "",
    }
}

/// The first place where two values of the same structure differ, and the two values there.
fn first_difference<'a>(this: &'a Value, other: &'a Value) -> (String, &'a Value, &'a Value) {
    let parts: Vec<(String, &Value, &Value)> = match (this, other) {
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            let pairs = a.iter().zip(b).enumerate();
            pairs.map(|(index, (a, b))| (format!("[{index}]"), a, b)).collect()
        }
        (Value::Object(a), Value::Object(b)) => {
            let pairs = a.iter().filter_map(|(key, a)| Some((key, a, b.get(key)?)));
            pairs.map(|(key, a, b)| (format!(".{key}"), a, b)).collect()
        }
        _ => Vec::new(),
    };
    match parts.into_iter().find(|(_, a, b)| a != b) {
        Some((place, a, b)) => {
            let (within, a, b) = first_difference(a, b);
            (place + &within, a, b)
        }
        None => (String::new(), this, other),
    }
}

impl VehicleParams {
    /// Whether the file's own physics has the same effects, lag and delay as another file's.
    pub fn is_modelled_as(&self, other: &Self) -> bool {
        self.modelled_effects == other.modelled_effects
            && self.motor_time_constant_s == other.motor_time_constant_s
            && self.command_delay_s == other.command_delay_s
    }

    /// The first difference from `other` in the numbers that identify a vehicle: the body, the
    /// rotors, the on-board law, the pack and gravity. A field that only one file has does not
    /// count: a file that gains a line describes the same vehicle. Estimates of the same vehicle do
    /// not count either: names and notes, lag and delay, hover thrust, air density, the meaning of
    /// the motor outputs, and the modelled effects, which a diagnosis extends.
    pub fn difference(&self, other: &Self) -> Option<Difference> {
        let (a, b) = (self, other);
        [
            Difference::of("mass", &a.mass, &b.mass),
            Difference::of("inertia", &a.inertia, &b.inertia),
            Difference::of("rotors", &a.rotors, &b.rotors),
            Difference::of_both("attitude_pd", &a.attitude_pd, &b.attitude_pd),
            Difference::of_both("attitude_cascade", &a.attitude_cascade, &b.attitude_cascade),
            Difference::of("battery", &a.battery, &b.battery),
            Difference::of("gravity", &a.gravity, &b.gravity),
            Difference::of("rotor_radius_m", &a.rotor_radius_m, &b.rotor_radius_m),
            Difference::of_both("rotor_max_rpm", &a.rotor_max_rpm, &b.rotor_max_rpm),
            Difference::of_both(
                "linear_drag_N_per_m_s",
                &a.linear_drag_n_per_m_s,
                &b.linear_drag_n_per_m_s,
            ),
            Difference::of_both(
                "angular_damping_Nms",
                &a.angular_damping_nms,
                &b.angular_damping_nms,
            ),
        ]
        .into_iter()
        .flatten()
        .next()
    }
}

#[cfg(test)]
mod tests {
    use crate::params::tests::quad;
    use crate::params::{MotorOutput, VehicleParams};

    #[test]
    fn differing_rotor_is_named() {
        let mut other = quad();
        other.rotors[2].thrust_max_n = 7.5;
        let text = quad().difference(&other).expect("a difference").to_string();
        assert!(text.starts_with("rotors[2].thrust_max_N is 7.5 there and "), "{text}");
        assert!(!text.contains('{'), "{text}");
    }

    #[test]
    fn differing_mass_has_its_unit() {
        let (mut this, mut other) = (quad(), quad());
        (this.mass, other.mass) = (1.5, 0.03);
        let text = this.difference(&other).expect("a difference").to_string();
        assert_eq!(text, "mass is 0.03 kg there and 1.5 kg in this vehicle");
    }

    #[test]
    fn difference_covers_the_vehicle_and_not_beliefs_about_it() {
        let difference = |change: &dyn Fn(&mut VehicleParams)| {
            let mut other = quad();
            change(&mut other);
            quad().difference(&other).map(|difference| difference.field)
        };
        assert_eq!(difference(&|v| v.gravity = 1.62), Some("gravity"));
        assert_eq!(difference(&|v| v.mass = 1.3), Some("mass"));
        assert_eq!(difference(&|v| v.rotors[1].spin = 1), Some("rotors"));
        assert_eq!(difference(&|v| v.rotor_max_rpm = Some(8000.0)), Some("rotor_max_rpm"));
        let belief = difference(&|v| {
            v.name.push('2');
            v.command_delay_s = 0.02;
            v.modelled_effects.insert_argument("motor_lag:tau_s=0.05").unwrap();
        });
        assert_eq!(belief, None);
    }

    #[test]
    fn modelled_effects_lag_and_delay_make_another_model() {
        let changes: [fn(&mut VehicleParams); 3] = [
            |v| v.command_delay_s += 0.001,
            |v| v.motor_time_constant_s += 0.001,
            |v| v.modelled_effects.insert_argument("wind:north_m_s=2").unwrap(),
        ];
        assert!(quad().is_modelled_as(&quad()));
        for change in changes {
            let mut other = quad();
            change(&mut other);
            assert!(!quad().is_modelled_as(&other));
        }
    }

    #[test]
    fn added_optional_key_is_no_difference() {
        let gains: [&dyn Fn(&mut VehicleParams); 6] = [
            &|v| v.attitude_cascade = Some(crate::params::cascade::tests::cascade()),
            &|v| v.attitude_pd = Some(crate::params::cascade::tests::cascade().as_pd()),
            &|v| v.linear_drag_n_per_m_s = Some(0.1),
            &|v| v.angular_damping_nms = Some([0.1; 3]),
            &|v| v.rotor_max_rpm = None,
            &|v| {
                v.motor_output = Some(MotorOutput {
                    message: "SERVO_OUTPUT_RAW".to_owned(),
                    fields: Vec::new(),
                    zero: 1000.0,
                    one: 2000.0,
                    disarmed: 900.0,
                });
                v.provenance.insert("mass".to_owned(), "scales".into());
            },
        ];
        for gain in gains {
            let mut other = quad();
            gain(&mut other);
            assert_eq!((quad().difference(&other), other.difference(&quad())), (None, None));
        }
    }

    #[test]
    fn difference_is_printed_in_file_terms() {
        let mut other = quad();
        other.rotor_max_rpm = Some(8000.0);
        let difference = quad().difference(&other).map(|difference| difference.to_string());
        let text = "rotor_max_rpm is 8000.0 there and 9000.0 in this vehicle";
        assert_eq!(difference.as_deref(), Some(text));
    }
}
