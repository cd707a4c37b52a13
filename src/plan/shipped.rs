//! The trajectory files embedded in the program.

use std::path::Path;

/// An embedded trajectory file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShippedTrajectory {
    /// Its name on the command line.
    pub name: &'static str,
    /// A short description.
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

/// All embedded trajectory files.
pub const SHIPPED_TRAJECTORIES: [ShippedTrajectory; 11] = shipped! {
    "hover": "holds a position",
    "figure-8": "a figure eight in the horizontal plane",
    "sinusoid-xy": "sines along north and east",
    "sinusoid-xz": "sines along north and up",
    "sinusoid-yz": "sines along east and up",
    "sinusoid-yaw": "a circle while turning, as in the paper",
    "yaw-rotation": "turns on the spot",
    "steps": "jumps between positions",
    "waypoints": "from waypoint to waypoint, at rest at each",
    "random-waypoints": "the same, with random waypoints from a seed",
    "race": "gates and waypoints in the shortest time; plan it first",
};

/// The shipped trajectory that `path` names: by its bare name, if no such file exists.
pub(super) fn shipped(path: &Path) -> Option<&'static ShippedTrajectory> {
    let found = SHIPPED_TRAJECTORIES.iter().find(|shipped| path == Path::new(shipped.name))?;
    (!path.exists()).then_some(found)
}

#[cfg(test)]
mod tests {
    use super::super::{Trajectory, TrajectoryFile};
    use super::*;

    #[test]
    fn shipped_trajectories_are_found_by_name() {
        for shipped in SHIPPED_TRAJECTORIES {
            match TrajectoryFile::load(Path::new(shipped.name)).expect(shipped.name) {
                TrajectoryFile::Desired(trajectory) => assert!(trajectory.duration() > 1.0),
                TrajectoryFile::Task(task) => {
                    assert_eq!((shipped.name, task.passages.len()), ("race", 5))
                }
            }
        }
        let error = Trajectory::load(Path::new("figure-9")).expect_err("refused").to_string();
        assert!(error.contains("figure-8"), "{error}");
    }
}
