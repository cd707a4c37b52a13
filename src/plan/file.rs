//! The trajectory file: named families with parameters, waypoints, or a table.

mod builder;
mod course;
mod family;
mod multisine;

use std::path::{Path, PathBuf};

use schemars::{Schema, schema_for};
use vehicle::bounded;

use self::builder::Builder;
use self::family::Family;
pub(in crate::plan) use self::multisine::{Multisine, Wave, YawWave};
use super::shipped::{SHIPPED_TRAJECTORIES, shipped};
use super::table::Table;
use super::time_optimal::Task;
use super::trajectory::{Shape, Trajectory};

/// The longest trajectory, s: a check samples all of it.
const DURATION_MAX_S: f64 = 86_400.0;

/// Largest file, in bytes: a table of one day at 30 rows per second fits.
const SIZE_MAX: u64 = 256 << 20;

/// Why a trajectory file is rejected.
#[derive(Debug, thiserror::Error)]
pub enum TrajectoryError {
    /// The file cannot be read.
    #[error("trajectory {path}: {source}{}", shipped_names(path))]
    Read {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The text does not match the schema.
    #[error("trajectory {path}: {message}")]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What was found and where.
        message: String,
    },
    /// A value is out of range.
    #[error("trajectory {path}: {field}: expected {expected}, found {found:?}")]
    Value {
        /// The file.
        path: PathBuf,
        /// The field.
        field: &'static str,
        /// The accepted range.
        expected: &'static str,
        /// The value found.
        found: f64,
    },
    /// The file gives places without times.
    #[error(
        "trajectory {path}: the family time-optimal states where to fly, not when; plan it first \
         with `downwash plan {path} -o plan.json`, and fly plan.json"
    )]
    Unplanned {
        /// The file.
        path: PathBuf,
    },
}

/// The content of a trajectory file.
#[derive(Clone, Debug)]
pub enum TrajectoryFile {
    /// A trajectory: a position at each time.
    Desired(Trajectory),
    /// Places to pass in minimum time; it must be planned first.
    Task(Task),
}

impl TrajectoryFile {
    /// Reads a trajectory file, or the shipped trajectory of that name: TOML that matches the
    /// schema, or CSV with a header.
    ///
    /// # Errors
    /// [`TrajectoryError`] names the file, the field, the expected and the found value.
    pub fn load(path: &Path) -> Result<Self, TrajectoryError> {
        load(path)
    }

    /// Reads the text of a trajectory file, or of the shipped trajectory of that name.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn text(path: &Path) -> Result<String, TrajectoryError> {
        if let Some(shipped) = shipped(path) {
            return Ok(shipped.text.to_owned());
        }
        bounded::read_to_string(path, SIZE_MAX)
            .map_err(|source| TrajectoryError::Read { path: path.into(), source })
    }

    /// Parses the text of a trajectory file: CSV if `origin`, which names it in errors, ends in .csv,
    /// else TOML.
    ///
    /// # Errors
    /// As [`TrajectoryFile::load`].
    pub fn parse(text: &str, origin: &Path) -> Result<Self, TrajectoryError> {
        parse(text, origin)
    }

    /// The trajectory, if the file holds one.
    fn desired(self, path: &Path) -> Result<Trajectory, TrajectoryError> {
        match self {
            Self::Desired(trajectory) => Ok(trajectory),
            Self::Task(_) => Err(TrajectoryError::Unplanned { path: path.into() }),
        }
    }
}

/// The names of the shipped trajectories, for a path that could be one.
fn shipped_names(path: &Path) -> String {
    if path.extension().is_some() || path.components().count() > 1 {
        return String::new();
    }
    let names = SHIPPED_TRAJECTORIES.map(|shipped| shipped.name).join(", ");
    format!("; shipped trajectories are {names}")
}

impl Trajectory {
    /// The JSON Schema of trajectory files.
    pub fn file_schema() -> Schema {
        schema_for!(Family)
    }

    /// As [`TrajectoryFile::load`], for files that hold a trajectory.
    ///
    /// # Errors
    /// As there, and for a file that must be planned first.
    pub fn load(path: &Path) -> Result<Self, TrajectoryError> {
        load(path)?.desired(path)
    }

    /// Parses the text of a trajectory file: CSV if `origin`, which names it in errors, ends in .csv,
    /// else TOML.
    ///
    /// # Errors
    /// As [`Trajectory::load`]. A relative path to another file is resolved against the folder of
    /// `origin`.
    pub fn parse(text: &str, origin: &Path) -> Result<Self, TrajectoryError> {
        parse(text, origin)?.desired(origin)
    }
}

fn load(path: &Path) -> Result<TrajectoryFile, TrajectoryError> {
    parse(&TrajectoryFile::text(path)?, path)
}

/// Reads a table of positions, whatever its name.
fn load_table(path: &Path) -> Result<TrajectoryFile, TrajectoryError> {
    parse_table(&TrajectoryFile::text(path)?, path)
}

fn parse_table(text: &str, path: &Path) -> Result<TrajectoryFile, TrajectoryError> {
    let table = Table::parse(text)
        .map_err(|message| TrajectoryError::Syntax { path: path.into(), message })?;
    let found = table.duration();
    if found > DURATION_MAX_S {
        return Err(TrajectoryError::Value {
            path: path.into(),
            field: "t_s",
            expected: "at most 86400 s from the first row to the last, in seconds",
            found,
        });
    }
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    Ok(TrajectoryFile::Desired(Trajectory::new(name, Shape::Table(table))))
}

fn parse(text: &str, path: &Path) -> Result<TrajectoryFile, TrajectoryError> {
    if path.extension().is_some_and(|extension| extension == "csv") {
        return parse_table(text, path);
    }
    let family: Family = toml::from_str(text).map_err(|error| TrajectoryError::Syntax {
        path: path.into(),
        message: error.to_string(),
    })?;
    Builder { origin: path }.build(family)
}

#[cfg(test)]
mod tests {
    use vehicle::frame::Ned;

    use super::*;

    fn parse_text(text: &str) -> Result<Trajectory, TrajectoryError> {
        Trajectory::parse(text, Path::new("test.toml"))
    }

    #[test]
    fn sinusoid_yaw_matches_the_papers_curve() {
        let text = "family = 'sinusoid-yaw'\naltitude_m = 1\nduration_s = 20\namplitude_m = 1\nperiod_s = 5\nyaw_period_s = 10\nramp_s = 2";
        let trajectory = parse_text(text).expect("a trajectory");
        assert_eq!(trajectory.duration(), 22.0);
        // Phase time 1.25 s (a quarter of the period) is reached half a ramp later.
        let quarter = trajectory.sample(1.25 + 1.0);
        assert!((quarter.position - Ned::new(1.0, 1.0, -1.0)).norm() < 1e-9);
        assert!((quarter.yaw_rate - std::f64::consts::TAU / 10.0).abs() < 1e-12);
        assert_eq!(trajectory.sample(0.0).velocity.norm(), 0.0);
    }

    #[test]
    fn unknown_families_and_keys_are_refused_by_name() {
        let error = |text| parse_text(text).expect_err("refused").to_string();
        assert!(error("family = 'loop'").contains("loop"));
        assert!(
            error("family = 'hover'\naltitude_m = 1\nduration_s = 3\nspeed = 2").contains("speed")
        );
        assert!(error("family = 'hover'\naltitude_m = nan\nduration_s = 3").contains("altitude_m"));
        assert!(error("family = 'hover'\naltitude_m = 1\nduration_s = -3").contains("duration_s"));
        assert!(
            error("family = 'random-waypoints'\naltitude_m = 1\nseed = 1\ncount = 2\nhalf_size_m = [1,1,1]\npace = {speeed_m_s = 2}")
                .contains("speeed_m_s")
        );
    }

    #[test]
    fn table_in_the_wrong_time_unit_is_refused() -> std::io::Result<()> {
        let name = format!("downwash-table-{}.csv", std::process::id());
        let path = std::env::temp_dir().join(name);
        std::fs::write(&path, "t_s,n_m,e_m,d_m\n0,0,0,-1\n20000000,1,0,-1\n")?;
        let loaded = load(&path);
        std::fs::remove_file(&path)?;
        let error = loaded.expect_err("refused").to_string();
        assert!(error.contains("t_s: expected at most 86400 s"), "{error}");
        assert!(error.contains("found 20000000"), "{error}");
        Ok(())
    }

    #[test]
    fn table_of_any_name_is_the_one_that_is_flown() -> std::io::Result<()> {
        let folder = std::env::temp_dir().join(format!("downwash-tables-{}", std::process::id()));
        std::fs::create_dir_all(&folder)?;
        let table = |end_s: u32| format!("t_s,n_m,e_m,d_m\n0,0,0,-1\n{end_s},1,0,-1\n");
        std::fs::write(folder.join("mission.csv"), table(2))?;
        std::fs::write(folder.join("mission.v2"), table(10))?;
        let duration = |file: &str| {
            let text = format!("family = 'csv'\nfile = '{file}'");
            Trajectory::parse(&text, &folder.join("t.toml")).expect("a trajectory").duration()
        };
        let durations = [duration("mission.v2"), duration("mission.csv"), duration("mission")];
        std::fs::remove_dir_all(&folder)?;
        assert_eq!(durations, [10.0, 2.0, 2.0]);
        Ok(())
    }

    #[test]
    fn every_shipped_file_parses() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/trajectories");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).expect("the folder") {
            let path = entry.expect("an entry").path();
            match load(&path).expect("a trajectory") {
                TrajectoryFile::Desired(trajectory) => {
                    assert!(trajectory.duration() > 1.0, "{}", path.display());
                }
                TrajectoryFile::Task(task) => assert!(!task.passages.is_empty()),
            }
            count += 1;
        }
        assert!(count >= 10);
    }
}
