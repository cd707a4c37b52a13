//! The configuration: TOML layers merged into each module's own settings, with the origin of each
//! value.

mod check;
mod settings;

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};

use toml::{Table, Value};
use vehicle::{SHIPPED, bounded};

use self::check::{check_adaptation, check_numbers, check_offboard};
pub use self::settings::{FormSetting, LinkSettings, Settings, SigningSettings};
use crate::plan::SHIPPED_TRAJECTORIES;

/// Version of the configuration's schema.
pub const SCHEMA_VERSION: u32 = 1;

/// Where a value came from; its display names the layer.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Built in.
    Default,
    /// A file.
    File(PathBuf),
    /// An environment variable.
    Environment(String),
    /// A flag of the command line.
    Flag(&'static str),
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Default => write!(f, "default"),
            Self::File(path) => write!(f, "{}", path.display()),
            Self::Environment(name) => write!(f, "${name}"),
            Self::Flag(name) => write!(f, "{name}"),
        }
    }
}

/// Why a configuration is rejected.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The requested file cannot be read.
    #[error("configuration {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A layer does not follow the schema.
    #[error("configuration from {origin}: {message}")]
    Schema {
        /// The layer.
        origin: Origin,
        /// What was found, and where.
        message: String,
    },
    /// A layer has a different schema version.
    #[error(
        "configuration from {origin}: schema_version: expected {SCHEMA_VERSION}, found {found}"
    )]
    Version {
        /// The layer.
        origin: Origin,
        /// The version in the layer.
        found: u32,
    },
    /// A variable is not UTF-8 text.
    #[error("configuration from {origin}: expected UTF-8 text, found {found:?}")]
    NotText {
        /// The variable.
        origin: Origin,
        /// The variable's value.
        found: OsString,
    },
    /// A value that makes a flight impossible.
    #[error("configuration from {origin}: {setting}: expected {expected}, found {found:?}")]
    Impossible {
        /// The layer that set it; where that is the default, the one that set what it contradicts.
        origin: Origin,
        /// The setting.
        setting: &'static str,
        /// What would be valid.
        expected: String,
        /// The value found.
        found: f64,
    },
}

/// Settings and the origin of every value, by its dotted path.
#[derive(Clone, Debug)]
pub struct Config {
    /// The merged values.
    pub settings: Settings,
    merged: Table,
    origins: BTreeMap<String, Origin>,
}

/// The former name of `[offboard]`, which is still read.
const OFFBOARD_ONCE: &str = "pilot";

/// Prefix of the environment variables: `DOWNWASH_CONTROL__RATE_HZ` sets `control.rate_hz`.
const ENVIRONMENT_PREFIX: &str = "DOWNWASH_";

/// Contains the signing key, where no file does.
pub const SIGNING_KEY_VARIABLE: &str = "DOWNWASH_SIGNING_KEY";

/// Variables with that prefix that are not settings: those of tests, benchmarks and the build.
const NOT_SETTINGS: [&str; 10] = [
    // A secret, which no list of settings may show.
    SIGNING_KEY_VARIABLE,
    "DOWNWASH_PRACTICE",
    "DOWNWASH_SHARED",
    "DOWNWASH_BIN",
    "DOWNWASH_SITL_BIN",
    "DOWNWASH_LOG",
    "DOWNWASH_PEERS",
    "DOWNWASH_PEERS_PROBLEM",
    "DOWNWASH_GIT_REVISION",
    "DOWNWASH_CAMPAIGN_SEED",
];

impl Config {
    /// Merges the layers, later over earlier: defaults, the system's file, the user's file, `file`,
    /// the environment, and the flags, given as dotted paths with values.
    ///
    /// # Errors
    /// [`ConfigError`] names the faulty layer. The system's and the user's file may be missing,
    /// `file` may not. Variables without the prefix may have any value.
    pub fn load(
        file: Option<&Path>,
        environment: impl Iterator<Item = (OsString, OsString)>,
        flags: Vec<(&'static str, &str, Value)>,
    ) -> Result<Self, ConfigError> {
        let mut config = Self::defaults();
        let standing = [Some(PathBuf::from("/etc")), user_folder(|name| std::env::var_os(name))];
        for folder in standing.into_iter().flatten() {
            let path = folder.join("downwash/config.toml");
            if path.is_file() {
                config.merge_file(&path)?;
            }
        }
        if let Some(path) = file {
            config.merge_file(path)?;
        }
        for (name, text) in environment {
            // Characters replaced in a name that is not UTF-8 make it an unknown setting.
            let name = name.to_string_lossy().into_owned();
            let Some(path) = name.strip_prefix(ENVIRONMENT_PREFIX) else { continue };
            if NOT_SETTINGS.contains(&name.as_str()) {
                continue;
            }
            let path = path.to_lowercase().replace("__", ".");
            let text = text.into_string().map_err(|found| ConfigError::NotText {
                origin: Origin::Environment(name.clone()),
                found,
            })?;
            // A number or boolean where the text parses as one, else a string.
            let value = text.parse::<Value>().unwrap_or_else(|_| Value::String(text.clone()));
            config.merge(nested(&path, value), &Origin::Environment(name))?;
        }
        for (flag, path, value) in flags {
            config.merge(nested(path, value), &Origin::Flag(flag))?;
        }
        // Last, because a limit in one layer may depend on one in another.
        config.check()?;
        Ok(config)
    }

    /// The default values.
    pub fn defaults() -> Self {
        let settings = Settings::default();
        // A struct of plain values is always a table.
        let merged = Table::try_from(&settings).unwrap_or_default();
        let mut origins = BTreeMap::new();
        for (path, _) in leaves("", &merged) {
            origins.insert(path, Origin::Default);
        }
        Self { settings, merged, origins }
    }

    /// Every value with its dotted path and origin, in order of path.
    pub fn rows(&self) -> impl Iterator<Item = (String, &Value, &Origin)> {
        leaves("", &self.merged).into_iter().filter_map(|(path, value)| {
            let origin = self.origins.get(&path)?;
            Some((path, value, origin))
        })
    }

    /// The merged values as TOML, as attached to flight logs.
    pub fn to_toml(&self) -> String {
        toml::to_string(&self.merged).unwrap_or_default()
    }

    fn check(&self) -> Result<(), ConfigError> {
        let settings = &self.settings;
        let checked = check_offboard(&settings.offboard);
        checked.and_then(|()| check_adaptation(&settings.control.adaptation)).map_err(
            |impossible| {
                let origins = impossible.settings.iter().filter_map(|path| self.origins.get(*path));
                let origin = origins.into_iter().find(|origin| **origin != Origin::Default);
                ConfigError::Impossible {
                    origin: origin.unwrap_or(&Origin::Default).clone(),
                    setting: impossible.settings.first().copied().unwrap_or_default(),
                    expected: impossible.expected,
                    found: impossible.found,
                }
            },
        )
    }

    fn merge_file(&mut self, path: &Path) -> Result<(), ConfigError> {
        let text = bounded::read_to_string(path, bounded::WRITTEN_MAX)
            .map_err(|source| ConfigError::Read { path: path.into(), source })?;
        let origin = Origin::File(path.into());
        // Parsed as settings first, because those errors show the place in the text.
        let schema = |message: String| ConfigError::Schema { origin: origin.clone(), message };
        toml::from_str::<Settings>(&text).map_err(|error| schema(error.to_string()))?;
        let mut table: Table =
            text.parse().map_err(|error: toml::de::Error| schema(error.to_string()))?;
        // Paths in a file are relative to it.
        let folder = path.parent().unwrap_or(Path::new(""));
        let relocate = |table: &mut Table, keys: &[&str]| {
            for key in keys {
                if let Some(Value::String(value)) = table.get_mut(*key) {
                    let path = folder.join(&*value);
                    if path.exists() || !is_shipped(key, value) {
                        *value = path.to_string_lossy().into_owned();
                    }
                }
            }
        };
        relocate(&mut table, &["vehicle", "trajectory", "log_dir"]);
        let signing = table.get_mut("link").and_then(|link| link.get_mut("signing"));
        if let Some(Value::Table(signing)) = signing {
            relocate(signing, &["key_file", "state_file"]);
        }
        self.merge(table, &origin)
    }

    fn merge(&mut self, mut layer: Table, origin: &Origin) -> Result<(), ConfigError> {
        if let Some(older) = layer.remove(OFFBOARD_ONCE) {
            layer.insert("offboard".to_owned(), older);
        }
        for (path, value) in leaves("", &layer) {
            check_numbers(&path, value)
                .map_err(|message| ConfigError::Schema { origin: origin.clone(), message })?;
            self.origins.insert(path, origin.clone());
        }
        overlay(&mut self.merged, layer);
        self.settings = self.merged.clone().try_into().map_err(|error: toml::de::Error| {
            ConfigError::Schema { origin: origin.clone(), message: error.to_string() }
        })?;
        match self.settings.schema_version {
            SCHEMA_VERSION => Ok(()),
            found => Err(ConfigError::Version { origin: origin.clone(), found }),
        }
    }
}

/// Folder of the user's configuration. An empty variable counts as unset.
fn user_folder(variable: impl Fn(&str) -> Option<OsString>) -> Option<PathBuf> {
    let folder = |name| variable(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    folder("XDG_CONFIG_HOME").or_else(|| folder("HOME").map(|home| home.join(".config")))
}

fn nested(path: &str, value: Value) -> Table {
    let mut parts = path.rsplit('.');
    let last = parts.next().unwrap_or_default();
    let mut table = Table::from_iter([(last.to_owned(), value)]);
    for part in parts {
        table = Table::from_iter([(part.to_owned(), Value::Table(table))]);
    }
    table
}

fn overlay(base: &mut Table, layer: Table) {
    for (key, value) in layer {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(value)) => overlay(inner, value),
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}

fn leaves<'a>(prefix: &str, table: &'a Table) -> Vec<(String, &'a Value)> {
    let mut found = Vec::new();
    for (key, value) in table {
        let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
        match value {
            Value::Table(inner) => found.extend(leaves(&path, inner)),
            value => found.push((path, value)),
        }
    }
    found
}

/// Whether a setting names a file that is built into the program.
fn is_shipped(setting: &str, name: &str) -> bool {
    match setting {
        "vehicle" => SHIPPED.iter().any(|shipped| shipped.name == name),
        "trajectory" => SHIPPED_TRAJECTORIES.iter().any(|shipped| shipped.name == name),
        _ => false,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(file: Option<&Path>, environment: &[(&str, &str)]) -> Result<Config, ConfigError> {
        let environment = environment.iter().map(|(k, v)| (k.into(), v.into()));
        Config::load(file, environment, vec![])
    }

    fn origin_of(config: &Config, key: &str) -> String {
        config
            .rows()
            .find(|(path, ..)| path == key)
            .map(|(_, _, origin)| origin.to_string())
            .unwrap_or_default()
    }

    #[test]
    fn former_pilot_section_is_read_as_offboard() {
        let environment = [("DOWNWASH_PILOT__SUPERVISOR__HOLD_S", "0.5")];
        let config = load(None, &environment).expect("a configuration");
        assert_eq!(config.settings.offboard.supervisor.hold_s, 0.5);
        let origin = origin_of(&config, "offboard.supervisor.hold_s");
        assert_eq!(origin, "$DOWNWASH_PILOT__SUPERVISOR__HOLD_S");
        let read = |text: &str| toml::from_str::<Settings>(text);
        let settings = read("[pilot.supervisor]\nhold_s = 0.5").expect("settings");
        assert_eq!(settings.offboard, config.settings.offboard);
        assert!(
            read("[pilot.supervisor]\nhold_s = 0.5\n[offboard.supervisor]\nrest_s = 1.0").is_err()
        );
    }

    #[test]
    fn later_layers_win_and_record_their_origin() {
        let folder = std::env::temp_dir().join(format!("downwash-config-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let path = folder.join("c.toml");
        std::fs::write(
            &path,
            "vehicle = 'v.toml'\ntrajectory = 'hover'\n[envelope]\ntilt_max_deg = 20\nspeed_max_m_s = 1.5\n",
        )
        .expect("written");
        let environment = [("DOWNWASH_ENVELOPE__TILT_MAX_DEG", "25.5"), ("OTHER", "1")];
        let config = load(Some(&path), &environment).expect("a configuration");
        assert_eq!(config.settings.envelope.tilt_max_deg, 25.5);
        assert_eq!(config.settings.envelope.speed_max_m_s, 1.5);
        assert_eq!(config.settings.vehicle, Some(folder.join("v.toml")));
        assert_eq!(config.settings.trajectory, Some("hover".into()), "a shipped one");
        assert_eq!(origin_of(&config, "envelope.tilt_max_deg"), "$DOWNWASH_ENVELOPE__TILT_MAX_DEG");
        assert_eq!(origin_of(&config, "envelope.speed_max_m_s"), path.display().to_string());
        assert_eq!(origin_of(&config, "envelope.radius_max_m"), "default");
        std::fs::remove_dir_all(folder).expect("removed");
    }

    #[test]
    fn shipped_file_lists_every_default() {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("config/downwash.toml");
        let shipped: Table =
            std::fs::read_to_string(path).expect("the file").parse().expect("TOML");
        let defaults = Config::defaults().merged;
        for (key, value) in &defaults {
            assert_eq!(shipped.get(key), Some(value), "{key}");
        }
        let examples = ["vehicle", "trajectory", "connect", "log_dir"];
        assert!(shipped.keys().all(|key| defaults.contains_key(key) || examples.contains(&&**key)));
    }

    #[test]
    fn non_finite_and_negative_limits_are_refused() {
        for (name, text) in [
            ("DOWNWASH_OFFBOARD__SAFETY__TILT_MAX_RAD", "nan"),
            ("DOWNWASH_CONTROL__RATE_HZ", "-100"),
            ("DOWNWASH_CONTROL__POSITION_M", "[0.4, inf, 0.3]"),
        ] {
            let message = load(None, &[(name, text)]).expect_err("refused").to_string();
            assert!(message.contains(name) && message.contains("at least 0"), "{message}");
        }
    }

    #[test]
    fn positions_may_be_negative() {
        let environment = [
            ("DOWNWASH_PLAN__BOX_M", "[[-2.0, -2.0, -3.0], [2.0, 2.0, -0.3]]"),
            ("DOWNWASH_COLLECT__HEADINGS_DEG", "[-90.0]"),
        ];
        let settings = load(None, &environment).expect("a configuration").settings;
        assert_eq!(settings.plan.box_m, Some([[-2.0, -2.0, -3.0], [2.0, 2.0, -0.3]]));
        assert_eq!(settings.collect.headings_deg, [-90.0]);
    }

    #[test]
    fn impossible_values_are_refused_with_their_layer() {
        for (name, text, setting) in [
            ("DOWNWASH_OFFBOARD__LIMITS__THRUST_MIN", "5.0", "offboard.limits.thrust_min"),
            ("DOWNWASH_OFFBOARD__LIMITS__THRUST_MAX", "0.03", "offboard.limits.thrust_min"),
            ("DOWNWASH_OFFBOARD__SUPERVISOR__RETRY_S", "1e300", "offboard.supervisor.retry_s"),
        ] {
            let message = load(None, &[(name, text)]).expect_err("refused").to_string();
            assert!(message.contains(name) && message.contains(setting), "{message}");
        }
        let both = [
            ("DOWNWASH_OFFBOARD__LIMITS__THRUST_MIN", "0.95"),
            ("DOWNWASH_OFFBOARD__LIMITS__THRUST_MAX", "0.99"),
        ];
        load(None, &both).expect("the later limit fits the earlier");
    }

    #[cfg(unix)]
    #[test]
    fn only_own_settings_must_be_utf_8() {
        use std::os::unix::ffi::OsStringExt;

        let load = |name: &str| {
            let environment = [(OsString::from(name), OsString::from_vec(vec![b'1', 0xff]))];
            Config::load(None, environment.into_iter(), vec![])
        };
        load("OTHER").expect("not a setting");
        load("DOWNWASH_BIN").expect("not a setting");
        let message = load("DOWNWASH_CONTROL__RATE_HZ").expect_err("refused").to_string();
        assert!(message.contains("$DOWNWASH_CONTROL__RATE_HZ: expected UTF-8"), "{message}");
    }

    #[test]
    fn empty_xdg_folder_counts_as_unset() {
        let user = |xdg: Option<&str>| {
            user_folder(|name| if name == "HOME" { Some("/h".into()) } else { xdg.map(Into::into) })
        };
        assert_eq!(user(Some("/x")), Some(PathBuf::from("/x")));
        assert_eq!(user(Some("")), Some(PathBuf::from("/h/.config")));
        assert_eq!(user(None), Some(PathBuf::from("/h/.config")));
    }

    #[test]
    fn unknown_keys_are_refused_with_the_layer() {
        let error = load(None, &[("DOWNWASH_ENVELOPE__TILD", "1")]).expect_err("refused");
        let message = error.to_string();
        assert!(
            message.contains("$DOWNWASH_ENVELOPE__TILD") && message.contains("tild"),
            "{message}"
        );
    }

    #[test]
    fn test_and_benchmark_variables_are_not_settings() {
        let environment = [("DOWNWASH_PEERS_PROBLEM", "problem"), ("DOWNWASH_SHARED", "shared")];
        load(None, &environment).expect("a configuration");
    }
}
