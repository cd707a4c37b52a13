//! The trajectory files that the program brings along.

use std::path::Path;

/// A trajectory file by its name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShippedTrajectory {
    /// Name.
    pub name: &'static str,
    /// What it is.
    pub about: &'static str,
    /// Text of the file, TOML.
    pub text: &'static str,
}

macro_rules! shipped {
    ($($name:literal: $about:literal),* $(,)?) => {
        [$(ShippedTrajectory {
            name: $name,
            about: $about,
            text: include_str!(concat!("../../config/trajectories/", $name, ".toml")),
        }),*]
    };
}

/// All of them.
pub const SHIPPED_TRAJECTORIES: [ShippedTrajectory; 10] = shipped! {
    "hover": "holds a place",
    "figure-8": "an eight in the plane",
    "sinusoid-xy": "sines along north and east",
    "sinusoid-xz": "sines along north and up",
    "sinusoid-yz": "sines along east and up",
    "sinusoid-yaw": "a circle while turning, as in the paper",
    "yaw-rotation": "turns on the spot",
    "steps": "jumps between places",
    "waypoints": "from place to place, at rest in each",
    "random-waypoints": "the same, by chance from a seed",
};

/// The shipped trajectory that `path` names: by its bare name, where no such file is there.
pub(super) fn shipped(path: &Path) -> Option<&'static ShippedTrajectory> {
    let found = SHIPPED_TRAJECTORIES.iter().find(|shipped| path == Path::new(shipped.name))?;
    (!path.exists()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::super::Trajectory;
    use super::*;

    #[test]
    fn shipped_trajectories_are_found_by_name() {
        for shipped in SHIPPED_TRAJECTORIES {
            let trajectory = Trajectory::load(Path::new(shipped.name)).expect(shipped.name);
            assert!(trajectory.duration() > 1.0, "{}", shipped.name);
        }
        let error = Trajectory::load(Path::new("figure-9")).expect_err("refused").to_string();
        assert!(error.contains("figure-8"), "{error}");
    }
}
