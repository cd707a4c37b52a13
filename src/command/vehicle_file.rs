//! The vehicle file of a command, and the doubts about its vehicle.

use std::path::Path;

use anyhow::{Context, anyhow};
use vehicle::effects::EffectSet;
use vehicle::{Doubt, Remark, VehicleParams};

use super::improved::{Additions, Form};
use super::{Exit, ExitContext, print_status};
use crate::config::Settings;

/// A vehicle file with its text, as the log keeps it.
#[derive(Clone, Debug)]
pub struct VehicleFile {
    /// Its path, or its name.
    pub name: String,
    /// The text: TOML or JSON.
    pub text: String,
    /// The parsed vehicle.
    pub params: VehicleParams,
}

impl VehicleFile {
    /// Reads and checks the file of a vehicle to fly, or the shipped vehicle of that name.
    ///
    /// # Errors
    /// The file cannot be read or violates the schema, or the vehicle cannot fly.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let params = VehicleParams::load(path).or_exit(Exit::Usage)?;
        refuse_grounded(&path.display().to_string(), &params)?;
        let text = vehicle::read(path)
            .with_context(|| format!("vehicle file {}", path.display()))
            .or_exit(Exit::Usage)?;
        Ok(Self { name: path.display().to_string(), text, params })
    }

    /// A vehicle from its file's text, TOML or JSON. Messages call it `name`.
    ///
    /// # Errors
    /// The text violates the schema, or the vehicle cannot fly.
    pub fn parse(name: &str, text: String) -> anyhow::Result<Self> {
        let params = match Form::of(Path::new(""), &text) {
            Form::Json => VehicleParams::from_json_str(&text),
            Form::Toml => VehicleParams::from_toml_str(&text),
        };
        let params = params.context(name.to_owned()).or_exit(Exit::Usage)?;
        refuse_grounded(name, &params)?;
        Ok(Self { name: name.to_owned(), text, params })
    }

    /// The vehicle with these effects added to its modelled ones, or replacing them.
    ///
    /// # Errors
    /// An effect needs a number that the file lacks.
    pub fn with_effects(&self, effects: &EffectSet) -> anyhow::Result<Self> {
        let form = Form::of(Path::new(""), &self.text);
        let additions = Additions::of_effects(effects)?;
        let text = additions.to_file(&self.text, &self.params, [form, form])?;
        Self::parse(&self.name, text)
    }

    /// The file's text, in the format of a file named `out`.
    ///
    /// # Errors
    /// The format cannot hold the provenance.
    pub fn to_text(&self, out: &Path) -> anyhow::Result<String> {
        let forms = [Form::of(Path::new(""), &self.text), Form::of(out, "")];
        Additions::of_effects(&EffectSet::new())?.to_file(&self.text, &self.params, forms)
    }

    /// The vehicle of a flag, else of the settings, else the built-in nano quadrotor.
    ///
    /// # Errors
    /// As [`VehicleFile::load`].
    pub fn chosen(flag: Option<&Path>, settings: &Settings) -> anyhow::Result<Self> {
        flag.or(settings.vehicle.as_deref()).map_or_else(Self::built_in, Self::load)
    }

    /// The built-in nano quadrotor.
    ///
    /// # Errors
    /// None; a test checks it.
    pub fn built_in() -> anyhow::Result<Self> {
        let text = include_str!("../../config/vehicles/crazyflie.toml").to_owned();
        let params = VehicleParams::from_toml_str(&text)?;
        Ok(Self { name: "crazyflie (built in)".to_owned(), text, params })
    }
}

pub(super) fn remark_text(remark: &Remark) -> String {
    match remark.doubt {
        Doubt::Unlikely => format!("unlikely: {}", remark.what),
        Doubt::CannotFly => format!("cannot fly: {}", remark.what),
    }
}

/// Warns of unlikely numbers of a vehicle to fly or to plan for.
///
/// # Errors
/// [`Exit::Usage`] if it cannot fly.
pub(super) fn refuse_grounded(file: &str, vehicle: &VehicleParams) -> anyhow::Result<()> {
    for remark in vehicle.remarks() {
        if remark.doubt == Doubt::CannotFly {
            return Err(anyhow!("vehicle file {file}: {}", remark_text(&remark)))
                .or_exit(Exit::Usage);
        }
        print_status(format_args!("vehicle file {file}: {}", remark_text(&remark)));
    }
    Ok(())
}

/// Warns of unlikely numbers of a vehicle; the user decides.
pub(super) fn warn(file: &Path, vehicle: &VehicleParams) {
    for remark in vehicle.remarks() {
        let file = file.display();
        print_status(format_args!(
            "vehicle file {file}: {}; using it as it is",
            remark_text(&remark)
        ));
    }
}
