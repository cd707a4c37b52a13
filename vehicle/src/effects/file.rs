//! The effects file: a TOML table of parameters for each effect, in the format of
//! `[modelled_effects]` in a vehicle file.

use std::path::{Path, PathBuf};

use super::{EffectError, EffectSet};
use crate::bounded;
use crate::law::Law;

/// Why the requested effects are refused.
#[derive(Debug, thiserror::Error)]
pub enum EffectsRefused {
    /// The file cannot be read.
    #[error("effects file {path}: {source}")]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML, or holds an entry that is not a valid effect.
    #[error(
        "effects file {path}: {message}; expected a table of parameters for each effect, such as \
         [motor_lag] with tau_s = 0.03"
    )]
    Syntax {
        /// The file.
        path: PathBuf,
        /// What the parser found and where.
        message: String,
    },
    /// A command-line argument is refused.
    #[error("--effect {argument}: {source}")]
    Argument {
        /// The argument as given.
        argument: String,
        /// Why it is refused.
        source: EffectError,
    },
}

impl EffectSet {
    /// The effects that a command line requests: an effects file, overridden by arguments such as
    /// `motor_lag:tau_s=0.03` or `@FILE` (another effects file).
    ///
    /// # Errors
    /// A file cannot be read, is not TOML, or holds an invalid effect; an argument is invalid; two
    /// arguments give one effect or law.
    pub fn requested(file: Option<&Path>, arguments: &[String]) -> Result<Self, EffectsRefused> {
        let mut effects = file.map_or(Ok(Self::new()), Self::load)?;
        let mut given = Self::new();
        // One-line laws come last, because they take names that no file uses.
        let (lines, named): (Vec<_>, Vec<_>) =
            arguments.iter().partition(|text| !text.starts_with('@') && Law::is_line(text));
        for argument in named {
            let refused = |source| EffectsRefused::Argument { argument: argument.clone(), source };
            let added = match argument.strip_prefix('@') {
                Some(path) => Self::load(Path::new(path))?,
                None => {
                    let mut one = Self::new();
                    one.insert_argument(argument).map_err(refused)?;
                    one
                }
            };
            if let Some(name) = given.shared(&added) {
                return Err(refused(EffectError::Twice { name: name.to_owned() }));
            }
            given = given.overlay(&added);
            effects = effects.overlay(&added);
            // Too many laws are an error here; the overlay drops the last ones.
            for law in added.laws() {
                effects.insert_law(law.clone()).map_err(refused)?;
            }
        }
        for line in lines {
            effects
                .insert_argument(line)
                .map_err(|source| EffectsRefused::Argument { argument: line.clone(), source })?;
        }
        Ok(effects)
    }

    fn load(path: &Path) -> Result<Self, EffectsRefused> {
        let text = bounded::read_to_string(path, bounded::WRITTEN_MAX)
            .map_err(|source| EffectsRefused::Read { path: path.to_owned(), source })?;
        toml::from_str(&text).map_err(|error| EffectsRefused::Syntax {
            path: path.to_owned(),
            message: error.to_string().trim_end().to_owned(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{EffectId, MotorLag};

    #[test]
    fn arguments_override_the_file() {
        let folder = std::env::temp_dir().join(format!("sitl-effects-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let file = folder.join("effects.toml");
        std::fs::write(&file, "[motor_lag]\ntau_s = 0.05\n[mass]\nmass_kg = 1.5\n").unwrap();
        let asked = |more: &[&str]| {
            let more: Vec<String> = more.iter().map(|argument| (*argument).to_owned()).collect();
            EffectSet::requested(Some(&file), &more)
        };
        let lag = |more: &[&str]| {
            let effects = asked(more).unwrap();
            assert!(effects.contains(EffectId::Mass));
            effects.get::<MotorLag>().unwrap().tau_s
        };
        assert_eq!(lag(&[]), 0.05);
        assert_eq!(lag(&["motor_lag:tau_s=0.02"]), 0.02);
        let text = asked(&["motor_lag"]).unwrap_err().to_string();
        assert!(text.contains("--effect motor_lag"), "{text}");

        let again = |more: &[&str]| asked(more).unwrap_err().to_string();
        let at_file = format!("@{}", file.display());
        for more in [
            ["motor_lag:tau_s=0.02", "motor_lag:tau_s=0.03"],
            ["mass:mass_kg=1.2", at_file.as_str()],
            [at_file.as_str(), at_file.as_str()],
        ] {
            let text = again(&more);
            assert!(text.contains("is given twice") && text.contains(more[1]), "{text}");
        }
        // Each one-line law is a law of its own.
        let law = "force_x = -0.02[kg/s] * air_x";
        assert_eq!(asked(&[law, law]).unwrap().laws().len(), 2);

        std::fs::write(&file, "[motor_lack]\n").unwrap();
        let text = asked(&[]).unwrap_err().to_string();
        assert!(text.contains("effects.toml") && text.contains("motor_lack"), "{text}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
