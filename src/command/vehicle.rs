//! `downwash vehicle`: makes, checks and lists vehicle files.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, anyhow};
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::export::Peer;
use vehicle::{Remark, SHIPPED, VehicleParams};

use super::patience::Patience;
use super::setup::endpoint;
use super::vehicle_file::remark_text;
use super::{
    Exit, ExitContext, in_words, link_parameters, output, print_json, print_status, print_text,
    write_file,
};
use crate::cli::{InitArgs, LayoutChoice, PeerChoice, VehicleCommand};
use crate::log::import;
use crate::parameters::{self, Parameters};
use crate::plan::SHIPPED_TRAJECTORIES;
use crate::vehicle_check::{self, Held, Verdict};
use crate::vehicle_init::{Draft, Layout, Measured, Wanting};

/// An inch in m.
const INCH: f64 = 0.0254;
/// Largest parameter file, bytes.
const PARAMETER_FILE_MAX: u64 = 1 << 20;

pub(super) fn run(command: VehicleCommand) -> anyhow::Result<Exit> {
    match command {
        VehicleCommand::List { json } => list(json),
        VehicleCommand::Check { file, log, json } => check(&file, log.as_deref(), json),
        VehicleCommand::Init(args) => init(&args),
        VehicleCommand::Export { file, to, out, force } => export(&file, to, out.as_deref(), force),
    }
}

#[derive(JsonSchema, Serialize)]
pub(super) struct Listed {
    schema: &'static str,
    schema_version: u32,
    vehicles: Vec<Named>,
    trajectories: Vec<Named>,
}

#[derive(JsonSchema, Serialize)]
struct Named {
    name: &'static str,
    about: &'static str,
}

fn list(json: bool) -> anyhow::Result<Exit> {
    let vehicles = SHIPPED.map(|shipped| Named { name: shipped.name, about: shipped.about });
    let trajectories =
        SHIPPED_TRAJECTORIES.map(|shipped| Named { name: shipped.name, about: shipped.about });
    let listed = Listed {
        schema: "downwash.vehicle.list",
        schema_version: 1,
        vehicles: vehicles.into(),
        trajectories: trajectories.into(),
    };
    if json {
        print_json(&listed)?;
        return Ok(Exit::Ok);
    }
    let rows = |named: &[Named]| -> String {
        named.iter().map(|named| format!("  {:17} {}\n", named.name, named.about)).collect()
    };
    let (vehicles, trajectories) = (rows(&listed.vehicles), rows(&listed.trajectories));
    print_text(&format!(
        "vehicles, for --vehicle\n{vehicles}trajectories, for `fly` and `plan`\n{trajectories}"
    ))?;
    Ok(Exit::Ok)
}

fn export(file: &Path, to: PeerChoice, out: Option<&Path>, force: bool) -> anyhow::Result<Exit> {
    let peer = match to {
        PeerChoice::RotorPy => Peer::RotorPy,
        PeerChoice::DroneModels => Peer::DroneModels,
        PeerChoice::Px4Sih => Peer::Px4Sih,
        PeerChoice::MuJoCo => Peer::MuJoCo,
        PeerChoice::CasAdi => Peer::CasAdi,
    };
    if let Some(out) = out {
        refuse_old(out, Some(file), force)?;
    }
    let vehicle = VehicleParams::load(file).or_exit(Exit::Usage)?;
    let exported = vehicle::export::export(&vehicle, peer).or_exit(Exit::Usage)?;
    for lost in &exported.lost {
        print_status(format_args!("{} does not express {lost}", peer.name()));
    }
    match out {
        None => print_text(&exported.text)?,
        Some(path) => write_file(path, exported.text.as_bytes())?,
    }
    Ok(Exit::Ok)
}

#[derive(JsonSchema, Serialize)]
pub(super) struct Checked<'a> {
    schema: &'static str,
    schema_version: u32,
    file: String,
    vehicle: &'a str,
    #[schemars(with = "Vec<serde_json::Value>")]
    remarks: &'a [Remark],
    /// The log's measurements of what the file predicts; null without `--log`.
    held: &'a [Held],
}

fn check(file: &Path, log: Option<&Path>, json: bool) -> anyhow::Result<Exit> {
    let vehicle = VehicleParams::load(file).or_exit(Exit::Usage)?;
    let remarks = vehicle.remarks();
    let held = match log {
        Some(log) => against(log, &vehicle).with_context(|| log.display().to_string())?,
        None => Vec::new(),
    };
    let fits = remarks.is_empty() && held.iter().all(|held| held.verdict != Verdict::Differs);
    if json {
        print_json(&Checked {
            schema: "downwash.vehicle.check",
            schema_version: 1,
            file: file.display().to_string(),
            vehicle: &vehicle.name,
            remarks: &remarks,
            held: &held,
        })?;
    } else {
        let file = file.display();
        let mut lines: Vec<String> = remarks.iter().map(remark_text).collect();
        if lines.is_empty() {
            lines.push("the numbers fit each other".to_owned());
        }
        lines.extend(held.iter().map(|held| match held.verdict {
            Verdict::Fits => format!("fits: {}", held.what),
            Verdict::Differs => format!("differs: {}", held.what),
            Verdict::NotShown => held.what.clone(),
        }));
        print_text(&lines.iter().map(|line| format!("{file}: {line}\n")).collect::<String>())?;
    }
    Ok(if fits { Exit::Ok } else { Exit::Check })
}

/// The log's measurements of what the file predicts.
fn against(log: &Path, vehicle: &VehicleParams) -> anyhow::Result<Vec<Held>> {
    let _patience = Patience::with(format!("comparing the file with {}", log.display()));
    let flight = import::open(log, None).or_exit(Exit::Usage)?;
    vehicle_check::held(&flight, vehicle).or_exit(Exit::Usage)
}

/// A new vehicle file, and the values that it lacks: the JSON of `vehicle init`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct Made {
    schema: &'static str,
    schema_version: u32,
    source: String,
    autopilot: Option<&'static str>,
    out: Option<String>,
    /// Values without a source, with the way to measure each.
    pub missing: Vec<Wanting>,
    /// Estimated values.
    pub estimated: Vec<Wanting>,
    #[schemars(with = "Vec<serde_json::Value>")]
    remarks: Vec<Remark>,
    /// The file's text; complete if nothing is missing.
    pub toml: String,
    /// The estimates that were used, by key.
    #[serde(skip)]
    assumptions: BTreeMap<&'static str, String>,
}

/// Makes a vehicle file from an autopilot's parameters and measured numbers, and writes none.
///
/// # Errors
/// Impossible numbers, or parameters that cannot be read or are not a quadrotor's.
pub fn make(args: &InitArgs) -> anyhow::Result<Made> {
    let measured = measured(args)?;
    let (source, parameters) = match (&args.file, &args.connect) {
        (Some(file), _) => (file.display().to_string(), of_file(file)?),
        (None, Some(url)) => {
            let parameters = link_parameters::read(endpoint(url)?, args.system)?;
            (format!("the parameters of the vehicle at {url}"), parameters)
        }
        (None, None) => ("measured numbers".to_owned(), Parameters::default()),
    };
    let draft = Draft::new(&source, &parameters, &measured)
        .with_context(|| source.clone())
        .or_exit(Exit::Usage)?;
    let (toml, missing, estimated) = (draft.to_toml(), draft.missing(), draft.estimated());
    let remarks = match VehicleParams::from_toml_str(&toml) {
        Ok(vehicle) => vehicle.remarks(),
        Err(_) if !missing.is_empty() => Vec::new(),
        Err(error) => return Err(error).context(source).or_exit(Exit::Usage),
    };
    let taken = missing.iter().chain(&estimated);
    let taken = taken.filter_map(|wanting| Some((wanting.key, draft.assumption(wanting.key)?)));
    Ok(Made {
        schema: "downwash.vehicle.init",
        schema_version: 1,
        autopilot: draft.autopilot.map(parameters::Autopilot::name),
        out: args.out.as_ref().map(|out| out.display().to_string()),
        assumptions: taken.collect(),
        source,
        missing,
        estimated,
        remarks,
        toml,
    })
}

/// Refuses to overwrite an input, and to overwrite anything without `force`.
fn refuse_old(out: &Path, read: Option<&Path>, force: bool) -> anyhow::Result<()> {
    output::refuse_input(out, read)?;
    if out.exists() && !force {
        let error = anyhow!("{} already exists: give another name, or --force", out.display());
        return Err(error).or_exit(Exit::Usage);
    }
    Ok(())
}

fn init(args: &InitArgs) -> anyhow::Result<Exit> {
    if let Some(out) = &args.out {
        refuse_old(out, args.file.as_deref(), args.force)?;
    }
    let made = make(args)?;
    if let Some(out) = &args.out {
        write_file(out, made.toml.as_bytes())?;
    }
    if args.json {
        print_json(&made)?;
        return Ok(Exit::Ok);
    }
    let Made { missing, estimated, remarks, toml, assumptions, .. } = &made;
    if args.out.is_none() {
        print_text(toml)?;
    }
    for (state, keys) in [("missing", missing), ("estimated", estimated)] {
        for Wanting { key, what, how } in keys {
            let taken = assumptions.get(key).map(|taken| format!(" ({taken})"));
            print_status(format_args!(
                "{state}: {key}, {what}{}: {how}",
                taken.unwrap_or_default()
            ));
        }
    }
    for remark in remarks {
        print_status(format_args!("{}", remark_text(remark)));
    }
    if let Some(out) = &args.out {
        let suffix = if missing.is_empty() { "" } else { ", without the missing numbers" };
        print_status(format_args!("wrote {}{suffix}", out.display()));
    }
    Ok(Exit::Ok)
}

fn measured(args: &InitArgs) -> anyhow::Result<Measured> {
    let positive = |flag: &str, value: Option<f64>| match value {
        Some(value) if !(value.is_finite() && value > 0.0) => {
            Err(anyhow!("{flag}: expected a number above 0, found {value}")).or_exit(Exit::Usage)
        }
        value => Ok(value),
    };
    let arm = positive("--arm", args.arm)?;
    let wheelbase = positive("--wheelbase", args.wheelbase)?;
    let hover_throttle = positive("--hover-throttle", args.hover_throttle)?;
    if hover_throttle.is_some_and(|share| share >= 1.0) {
        let error = anyhow!("--hover-throttle: expected a share below 1, such as 0.45");
        return Err(error).or_exit(Exit::Usage);
    }
    if args.motor_lag.is_some_and(|lag| !(0.0..=2.0).contains(&lag)) {
        return Err(anyhow!("--motor-lag: expected seconds in 0..=2")).or_exit(Exit::Usage);
    }
    let inertia = match args.inertia.as_slice() {
        [] => None,
        &[x, y, z] => {
            for moment in [x, y, z] {
                positive("--inertia", Some(moment))?;
            }
            Some([x, y, z])
        }
        other => {
            let error =
                anyhow!("--inertia: expected three numbers as 0.01,0.01,0.02, found {other:?}");
            return Err(error).or_exit(Exit::Usage);
        }
    };
    Ok(Measured {
        name: args.name.clone(),
        mass_kg: positive("--mass", args.mass)?,
        inertia,
        arm_m: arm.or(wheelbase.map(|length| 0.5 * length)),
        layout: args.layout.map(|layout| match layout {
            LayoutChoice::X => Layout::X,
            LayoutChoice::Plus => Layout::Plus,
        }),
        thrust_max_n: positive("--thrust", args.thrust)?,
        hover_throttle,
        propeller_m: positive("--propeller", args.propeller)?.map(|inches| INCH * inches),
        torque_ratio_m: positive("--torque-ratio", args.torque_ratio)?,
        motor_lag_s: args.motor_lag,
        cells: args.cells.filter(|cells| *cells > 0),
    })
}

/// The parameters in a parameter file or a flight log.
fn of_file(file: &Path) -> anyhow::Result<Parameters> {
    let name = file.display().to_string();
    let length = std::fs::metadata(file).context(name.clone()).or_exit(Exit::Usage)?.len();
    let mut why_none = None;
    if length <= PARAMETER_FILE_MAX {
        let bytes = std::fs::read(file).context(name.clone()).or_exit(Exit::Usage)?;
        match parameters::parse(&bytes) {
            Ok(found) if found.autopilot().is_some() => return Ok(found),
            Ok(_) => {
                let error = anyhow!("{name}: its parameters are neither PX4's nor ArduCopter's");
                return Err(error).or_exit(Exit::Usage);
            }
            Err(error) => why_none = Some(error),
        }
    }
    let flight = match (import::open(file, None), why_none) {
        (Ok(flight), _) => flight,
        (Err(error), Some(why_none)) => {
            let error = in_words(&error.into());
            return Err(anyhow!("{error}; it is not a parameter file either: {why_none}"))
                .or_exit(Exit::Usage);
        }
        (Err(error), None) => return Err(error).or_exit(Exit::Usage),
    };
    let found = Parameters::from(flight.facts.parameters);
    if found.autopilot().is_none() {
        let error = anyhow!(
            "{name}: the log states no parameters of PX4 or ArduCopter; take a log that the \
             autopilot wrote, a parameter file, or --connect"
        );
        return Err(error).or_exit(Exit::Usage);
    }
    Ok(found)
}
