//! The vehicle files that are built into the program.

use std::path::Path;

use crate::bounded;

/// A vehicle file that is built into the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shipped {
    /// Name of the file and of the vehicle.
    pub name: &'static str,
    /// One-line description for people.
    pub about: &'static str,
    /// Content of the file, TOML.
    pub text: &'static str,
}

/// Every shipped vehicle, sorted by name.
pub const SHIPPED: [Shipped; 2] = [
    Shipped {
        name: "crazyflie",
        about: "a nano quadrotor of 30 g, X layout",
        text: include_str!("../../vehicles/crazyflie.toml"),
    },
    Shipped {
        name: "quad1200",
        about: "a quadrotor of 1.2 kg with 10 inch propellers, X layout",
        text: include_str!("../../vehicles/quad1200.toml"),
    },
];

/// The shipped vehicle that `path` names. A file at that path takes precedence.
pub fn shipped(path: &Path) -> Option<&'static Shipped> {
    let found = SHIPPED.iter().find(|shipped| path == Path::new(shipped.name))?;
    (!path.exists()).then_some(found)
}

/// Content of the vehicle file at `path`, or of the shipped vehicle of that name.
///
/// # Errors
/// The file cannot be read.
pub fn read(path: &Path) -> std::io::Result<String> {
    match shipped(path) {
        Some(shipped) => Ok(shipped.text.to_owned()),
        None => bounded::read_to_string(path, bounded::WRITTEN_MAX),
    }
}

#[cfg(test)]
mod tests {
    use super::super::{VehicleError, VehicleParams};
    use super::*;

    #[test]
    fn shipped_vehicles_are_found_by_name_without_remarks() {
        for Shipped { name, text, .. } in SHIPPED {
            let vehicle = VehicleParams::load(name).unwrap();
            assert_eq!(vehicle.name, name);
            assert_eq!(vehicle, VehicleParams::from_toml_str(text).unwrap());
            assert_eq!(vehicle.remarks(), [], "{name}");
        }
    }

    #[test]
    fn unknown_name_error_lists_the_names() {
        let error = VehicleParams::load("crazyfly").unwrap_err();
        assert!(matches!(error, VehicleError::Read { .. }));
        let text = error.to_string();
        assert!(text.contains("crazyfly") && text.contains("crazyflie, quad1200"), "{text}");
    }
}
