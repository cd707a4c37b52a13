//! `downwash vehicle`: makes, checks and lists vehicle files.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, anyhow};
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::export::Peer;
use vehicle::{Remark, SHIPPED, VehicleParams};

use super::patience::Patience;
use super::vehicle_file::{remark_text, warn};
use super::{
    Exit, ExitContext, error_text, link_parameters, output, print_json, print_status, print_text,
    write_file,
};
use crate::cli::{InitArgs, LayoutChoice, ListenArgs, PeerChoice, VehicleCommand};
use crate::log::import::{self, ImportError};
use crate::parameters::{self, OneVehicle, ParameterFile, Parameters};
use crate::plan::SHIPPED_TRAJECTORIES;
use crate::vehicle_check::{self, Held, Verdict, other_vehicle};
use crate::vehicle_init::{Draft, Layout, Measured, Wanting};

/// An inch in m.
const INCH: f64 = 0.0254;
/// Largest parameter file, bytes.
const PARAMETER_FILE_MAX: u64 = 1 << 20;

pub(super) fn run(command: VehicleCommand) -> anyhow::Result<Exit> {
    match command {
        VehicleCommand::List { json } => list(json),
        VehicleCommand::Check { file, log, mapping, json } => {
            let flight = log.as_deref().map(|log| Shown { log, mapping: mapping.as_deref() });
            check(&file, flight, json)
        }
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
    warn(file, &vehicle);
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

/// The log to compare a vehicle file with.
#[derive(Clone, Copy)]
struct Shown<'a> {
    log: &'a Path,
    /// Mapping of its columns, if it is a table.
    mapping: Option<&'a Path>,
}

fn check(file: &Path, flight: Option<Shown<'_>>, json: bool) -> anyhow::Result<Exit> {
    let vehicle = VehicleParams::load(file).or_exit(Exit::Usage)?;
    let remarks = vehicle.remarks();
    let held = match flight {
        Some(flight) => against(flight, &vehicle)?,
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
fn against(shown: Shown<'_>, vehicle: &VehicleParams) -> anyhow::Result<Vec<Held>> {
    let Shown { log, mapping } = shown;
    let _patience = Patience::with(format!("comparing the file with {}", log.display()));
    // Its errors name the log.
    let flight = import::open(log, mapping).or_exit(Exit::Usage)?;
    let held = vehicle_check::held(&flight, vehicle);
    held.with_context(|| log.display().to_string()).or_exit(Exit::Usage)
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
        (Some(file), _) => (file.display().to_string(), of_file(file, args.system)?),
        (None, Some(url)) => {
            let listen = ListenArgs {
                connect: Some(url.clone()),
                system: args.system,
                seconds: None,
                config: args.config.clone(),
                json: args.json,
            };
            let parameters = link_parameters::read(&listen)?;
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
    output::check_output(out, read)?;
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
    if let Some(share) = hover_throttle.filter(|share| *share >= 1.0) {
        let error =
            anyhow!("--hover-throttle: expected a share below 1, such as 0.45, found {share}");
        return Err(error).or_exit(Exit::Usage);
    }
    if let Some(lag) = args.motor_lag.filter(|lag| !(0.0..=2.0).contains(lag)) {
        let error = anyhow!("--motor-lag: expected 0 to 2 s, found {lag}");
        return Err(error).or_exit(Exit::Usage);
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

/// The parameters of `system`, or of the only vehicle, in a parameter file or a flight log.
fn of_file(file: &Path, system: Option<u8>) -> anyhow::Result<Parameters> {
    let name = file.display().to_string();
    let length = std::fs::metadata(file).context(name.clone()).or_exit(Exit::Usage)?.len();
    let mut why_none = None;
    if length <= PARAMETER_FILE_MAX {
        let bytes = std::fs::read(file).context(name.clone()).or_exit(Exit::Usage)?;
        match ParameterFile::parse(&bytes) {
            Ok(found) => return of_parameter_file(&name, &found, system),
            Err(error) => why_none = Some(error),
        }
    }
    let flight = match (import::open(file, None), why_none) {
        (Ok(flight), _) => flight,
        (Err(error), Some(why_none)) => {
            let found = match error {
                ImportError::NoMapping { .. } => {
                    format!("{name} is a table, which states no parameters")
                }
                error => error_text(&error.into()),
            };
            return Err(anyhow!("{found}; it is not a parameter file either: {why_none}"))
                .or_exit(Exit::Usage);
        }
        (Err(error), None) => return Err(error).or_exit(Exit::Usage),
    };
    if system.is_some() {
        let error = anyhow!(
            "--system chooses a vehicle on a link or in a parameter file, and {name} is a flight log of \
             one vehicle: leave --system out"
        );
        return Err(error).or_exit(Exit::Usage);
    }
    if let Some(kind) = other_vehicle(&flight.facts) {
        let error = anyhow!("{name}: the log is of {kind}; only quadrotors are supported");
        return Err(error).or_exit(Exit::Usage);
    }
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

/// The parameters of one vehicle in a parameter file; what is left out of it is reported.
fn of_parameter_file(
    name: &str,
    file: &ParameterFile,
    system: Option<u8>,
) -> anyhow::Result<Parameters> {
    let found = file.vehicle(system).with_context(|| name.to_owned()).or_exit(Exit::Usage)?;
    let OneVehicle { parameters, remarks } = found;
    for remark in remarks {
        print_status(format_args!("{name}: {remark}"));
    }
    if parameters.autopilot().is_none() {
        let some: Vec<&str> = parameters.keys().take(3).map(String::as_str).collect();
        let error = anyhow!(
            "{name}: expected parameters of PX4 or ArduCopter, found {} others, such as {}; export the \
             autopilot's",
            parameters.len(),
            some.join(", ")
        );
        return Err(error).or_exit(Exit::Usage);
    }
    Ok(parameters)
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use clap::Parser;

    use super::*;

    /// The flags of `vehicle init` alone.
    #[derive(Parser)]
    struct Init {
        #[command(flatten)]
        args: InitArgs,
    }

    /// A new folder of one test.
    fn folder(name: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("downwash-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        folder
    }

    /// What `vehicle init` makes of a parameter file with this text.
    fn made(name: &str, text: &str, flags: &[&str]) -> anyhow::Result<Made> {
        let folder = folder(name);
        let file = folder.join("quad.params");
        std::fs::write(&file, text).expect("a file");
        let arguments = ["init", file.to_str().expect("a path")];
        let arguments = arguments.into_iter().chain(flags.iter().copied());
        let made = make(&Init::try_parse_from(arguments)?.args);
        std::fs::remove_dir_all(&folder).expect("a folder");
        made
    }

    #[test]
    fn configuration_file_belongs_to_a_link() {
        let is_accepted =
            |flags: &[&str]| Init::try_parse_from(["init"].iter().chain(flags).copied()).is_ok();
        assert!(is_accepted(&["--connect", "udpin:127.0.0.1:0", "--config", "quad.toml"]));
        assert!(!is_accepted(&["--config", "quad.toml"]));
        assert!(!is_accepted(&["flight.ulg", "--config", "quad.toml"]));
    }

    #[test]
    fn table_is_compared_by_its_mapping() {
        let folder = folder("table");
        let log = folder.join("flight.csv");
        std::fs::write(&log, "t,x,y,z\n0,0,0,0\n1,0,0,0\n2,0,0,0\n").expect("a file");
        let mapping = folder.join("map.toml");
        let text = "world_frame = \"ned\"\n[time]\ncolumn = \"t\"\nunit = \"s\"\n\
            [position]\ncolumns = [\"x\", \"y\", \"z\"]\nunit = \"m\"\n";
        std::fs::write(&mapping, text).expect("a file");
        let vehicle = VehicleParams::load(Path::new("crazyflie")).expect("a vehicle");
        let refusal = |mapping: Option<&Path>| {
            let refused = against(Shown { log: &log, mapping }, &vehicle).expect_err("no flight");
            error_text(&refused)
        };
        let without = refusal(None);
        assert!(without.contains("--mapping"), "{without}");
        // It is read, and shows nothing in the air.
        let read = refusal(Some(&mapping));
        assert!(read.contains("flight.csv") && !read.contains("mapping"), "{read}");
        std::fs::remove_dir_all(&folder).expect("a folder");
    }

    /// PX4's simulated quadrotor as QGroundControl writes it, with this mass.
    fn rows(system: u8, component: u8, mass: &str) -> String {
        let text = include_str!("../../message/tests/parameters/px4_sih.params");
        let row = |line: &str| {
            let (name, value) = line.split_once(' ').expect("a parameter");
            let value = if name == "SIH_MASS" { mass } else { value };
            format!("{system}\t{component}\t{name}\t{value}\t9\n")
        };
        text.lines().map(row).collect()
    }

    #[test]
    fn vehicle_is_chosen_among_those_of_a_parameter_file() {
        let both = rows(1, 1, "1.0") + &rows(7, 1, "2.0") + "7\t100\tCAM_MODE\t1\t6\n";
        let refused = error_text(&made("both", &both, &[]).expect_err("two vehicles"));
        for said in ["quad.params", "system 1", "system 7", "--system"] {
            assert!(refused.contains(said), "{said}: {refused}");
        }
        let chosen = made("chosen", &both, &["--system", "7"]).expect("a vehicle file");
        let vehicle = VehicleParams::from_toml_str(&chosen.toml).expect("a vehicle");
        assert_eq!((vehicle.mass, chosen.missing), (2.0, Vec::new()));
    }

    #[test]
    fn unreadable_parameter_is_missing_only_where_it_is_needed() {
        let keys = |made: &Made| made.missing.iter().map(|m| m.key).collect::<Vec<_>>();
        let needless = rows(1, 1, "1.0") + "1\t1\tRC1_TRIM\tnan\t9\n";
        assert_eq!(keys(&made("needless", &needless, &[]).expect("a file")), Vec::<&str>::new());
        let needed = made("needed", &rows(1, 1, "nan"), &[]).expect("a file");
        assert_eq!(keys(&needed), ["mass"]);
    }
}
