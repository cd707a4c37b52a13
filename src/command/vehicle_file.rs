//! The vehicle file that a command is given, and what is doubtful of its vehicle.

use std::path::Path;

use anyhow::{Context, anyhow};
use vehicle::effects::EffectSet;
use vehicle::{Doubt, Remark, VehicleParams};

use super::improved::{Additions, Form};
use super::{Exit, ExitContext, print_status};

/// A vehicle file with its text, as the log keeps it.
#[derive(Clone, Debug)]
pub struct VehicleFile {
    /// Its path, or what it is called instead.
    pub name: String,
    /// As it is written: TOML or JSON.
    pub text: String,
    /// As it is read.
    pub params: VehicleParams,
}

impl VehicleFile {
    /// Reads and checks the file of a vehicle that is to fly, or the shipped one of that name.
    ///
    /// # Errors
    /// A file that cannot be read or does not follow the schema, or a vehicle that cannot fly.
    pub fn load(path: &Path) -> anyhow::Result<Self> {
        let params = VehicleParams::load(path).or_exit(Exit::Usage)?;
        refuse_grounded(&path.display().to_string(), &params)?;
        let text = vehicle::read(path)
            .with_context(|| format!("vehicle file {}", path.display()))
            .or_exit(Exit::Usage)?;
        Ok(Self { name: path.display().to_string(), text, params })
    }

    /// A vehicle from its file's text, TOML or JSON, that is called `name` in messages.
    ///
    /// # Errors
    /// Text that does not follow the schema, or a vehicle that cannot fly.
    pub fn parse(name: &str, text: String) -> anyhow::Result<Self> {
        let params = match Form::of(Path::new(""), &text) {
            Form::Json => VehicleParams::from_json_str(&text),
            Form::Toml => VehicleParams::from_toml_str(&text),
        };
        let params = params.context(name.to_owned()).or_exit(Exit::Usage)?;
        refuse_grounded(name, &params)?;
        Ok(Self { name: name.to_owned(), text, params })
    }

    /// The vehicle with these effects added to its modelled ones, or put in their places.
    ///
    /// # Errors
    /// Effects that need a number which the file lacks.
    pub fn with_effects(&self, effects: &EffectSet) -> anyhow::Result<Self> {
        let form = Form::of(Path::new(""), &self.text);
        let additions = Additions::of_effects(effects)?;
        let text = additions.to_file(&self.text, &self.params, [form, form])?;
        Self::parse(&self.name, text)
    }

    /// The file's text, in the form of a file named `out`.
    ///
    /// # Errors
    /// Provenance that the form cannot hold.
    pub fn to_text(&self, out: &Path) -> anyhow::Result<String> {
        let forms = [Form::of(Path::new(""), &self.text), Form::of(out, "")];
        Additions::of_effects(&EffectSet::new())?.to_file(&self.text, &self.params, forms)
    }

    /// The nano quadrotor that is built in.
    ///
    /// # Errors
    /// None: it is checked by a test.
    pub fn built_in() -> anyhow::Result<Self> {
        let text = include_str!("../../config/vehicles/crazyflie.toml").to_owned();
        let params = VehicleParams::from_toml_str(&text)?;
        Ok(Self { name: "crazyflie.toml (built in)".to_owned(), text, params })
    }
}

pub(super) fn remark_text(remark: &Remark) -> String {
    match remark.doubt {
        Doubt::Unlikely => format!("unlikely: {}", remark.what),
        Doubt::CannotFly => format!("cannot fly: {}", remark.what),
    }
}

/// Warns of what is unlikely of a vehicle that is to be flown or planned for.
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

/// Says what is unlikely of a vehicle; what its user believes is taken.
pub(super) fn warn(file: &Path, vehicle: &VehicleParams) {
    for remark in vehicle.remarks() {
        let file = file.display();
        print_status(format_args!(
            "vehicle file {file}: {}; using it as it is",
            remark_text(&remark)
        ));
    }
}
