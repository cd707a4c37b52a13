//! `downwash exam --fleet COUNT`: how well the diagnosis tells what a type has from what single vehicles have.

use std::fs;
use std::sync::Arc;
use std::time::Instant;

use anyhow::Context;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::effects::EffectId;

use super::super::fleet::find;
use super::super::{Exit, error_text, print_status, write_file};
use super::Hall;
use super::candidate::log_names;
use crate::cli::{DiagnoseArgs, ExamArgs};
use crate::diagnose::fleet::answer::{FleetAnswer, VehicleAnswer};
use crate::exam::fleet::{FleetCase, Shape};
use crate::exam::interval::Rate;
use crate::exam::order::Settings;
use crate::exam::world::{FileKind, LoopKind, World};

/// Number of flights into which a vehicle's time is divided.
const FLIGHTS: usize = 3;
/// Length of a vehicle's logs together, s.
const SECONDS: f64 = 60.0;

/// The JSON of `exam --fleet`, and its summary.json.
#[derive(JsonSchema, Serialize)]
pub(crate) struct FleetsSummary<'a> {
    schema: &'static str,
    schema_version: u32,
    seed: u64,
    /// Fleets with a shared effect in which the diagnosis names it, and nothing else, as the
    /// type's.
    shared: Rate,
    /// Fleets with a shared effect in which the diagnosis names it, with or without others.
    shared_named: Rate,
    /// 90 % intervals of the type's numbers that hold the truth.
    intervals: Rate,
    /// Fleets without a shared effect in which the diagnosis names one.
    invented: Rate,
    /// Damaged vehicles for which the diagnosis names their own effect, or an ambiguous one with it
    /// among the rivals.
    own: Rate,
    /// Vehicles without an effect of their own for which the diagnosis names one.
    own_invented: Rate,
    cases: &'a [FleetRow],
}

/// A fleet.
#[derive(JsonSchema, Serialize)]
pub(crate) struct FleetRow {
    name: String,
    file: FileKind,
    on_board: LoopKind,
    /// The true effect of the type.
    shared: Option<String>,
    /// The effects that are named as the type's.
    named: Vec<String>,
    /// Effects of groups, and effects that are undecided.
    groups: Vec<String>,
    /// Whether the intervals of the type's numbers hold the truth.
    held: Vec<bool>,
    vehicles: Vec<VehicleRow>,
    /// Wall time of the diagnosis, s.
    seconds: f64,
}

/// A vehicle.
#[derive(JsonSchema, Serialize)]
pub(crate) struct VehicleRow {
    name: String,
    /// Its true effect.
    own: Option<String>,
    /// The named effects.
    named: Vec<String>,
    ambiguous_with: Vec<String>,
    state: crate::diagnose::fleet::answer::State,
}

fn class(effect: &str) -> &str {
    effect.parse::<EffectId>().map_or(effect, |id| id.class().name())
}

fn has(named: &[String], effect: &str) -> bool {
    named.iter().any(|name| class(name) == class(effect))
}

impl VehicleRow {
    fn is_named(&self) -> Option<bool> {
        let own = self.own.as_ref()?;
        Some(has(&self.named, own) || !self.named.is_empty() && has(&self.ambiguous_with, own))
    }
}

pub(super) fn run(args: &ExamArgs, count: usize, hall: &Hall<'_>) -> anyhow::Result<Exit> {
    let world = if args.exact { World::Exact } else { World::Builders };
    let settings = Settings {
        flights: FLIGHTS,
        seconds: SECONDS / FLIGHTS as f64,
        world,
        ..Settings::default()
    };
    // The diagnosis of one fleet uses all cores.
    let alone = Hall { jobs: 1, ..*hall };
    let rows = alone.each(count + args.nulls, "diagnosing fleets of", |number| {
        let shape =
            Shape { vehicles: args.vehicles, damaged: args.damaged, shares: number < count };
        let case = match FleetCase::fly(&settings, hall.seed, number as u64, &shape) {
            Ok(case) => case,
            Err(error) => {
                print_status(format_args!("fleet {number}: left out: {error}"));
                return Ok(None);
            }
        };
        match hall.read_answer(&format!("fleet_{number:03}"), &case) {
            Ok(row) => Ok(row),
            Err(error) => {
                print_status(format_args!("fleet {number}: left out: {}", error_text(&error)));
                Ok(None)
            }
        }
    })?;
    let rows: Vec<FleetRow> = rows.into_iter().flatten().collect();
    let with = || rows.iter().filter_map(|row| Some((row, row.shared.as_ref()?)));
    let vehicles = || rows.iter().flat_map(|row| &row.vehicles);
    let summary = FleetsSummary {
        schema: "downwash.exam.fleets",
        schema_version: 1,
        seed: hall.seed,
        shared: Rate::of(
            with().map(|(row, shared)| has(&row.named, shared) && row.named.len() == 1),
        ),
        shared_named: Rate::of(with().map(|(row, shared)| has(&row.named, shared))),
        intervals: Rate::of(rows.iter().flat_map(|row| row.held.iter().copied())),
        invented: Rate::of(
            rows.iter().filter(|row| row.shared.is_none()).map(|row| !row.named.is_empty()),
        ),
        own: Rate::of(vehicles().filter_map(VehicleRow::is_named)),
        own_invented: Rate::of(
            vehicles().filter(|row| row.own.is_none()).map(|row| !row.named.is_empty()),
        ),
        cases: &rows,
    };
    hall.conclude(&summary, &text(&summary))
}

impl Hall<'_> {
    /// Diagnoses a fleet by its files alone, and compares the answer with the truth.
    fn read_answer(&self, name: &str, case: &FleetCase) -> anyhow::Result<Option<FleetRow>> {
        let folder = self.folder(name);
        let logs = folder.join("vehicles");
        let names: Vec<String> =
            (0..case.vehicles.len()).map(|vehicle| format!("v{vehicle:02}")).collect();
        for (vehicle, name) in case.vehicles.iter().zip(&names) {
            let own = logs.join(name);
            fs::create_dir_all(&own)
                .with_context(|| format!("cannot create the folder {}", own.display()))?;
            for (log, bytes) in log_names(vehicle.logs.len()).zip(&vehicle.logs) {
                write_file(&own.join(log), bytes)?;
            }
        }
        let file = folder.join("vehicle.json");
        let text = serde_json::to_vec_pretty(&case.nominal).context("vehicle.json")?;
        write_file(&file, &text)?;
        let mut args = DiagnoseArgs::new(Vec::new(), file);
        args.rows = folder.join("rows");
        args.twins = self.args.twins.unwrap_or(args.twins);
        let began = Instant::now();
        let found = find(&args, &logs, &Arc::default(), &|_, _, _| {})?;
        let seconds = began.elapsed().as_secs_f64();
        if !self.args.keep {
            let _ = fs::remove_dir_all(&folder);
        }
        Ok(found.map(|found| row(name, case, &found.answer, seconds)))
    }
}

fn row(name: &str, case: &FleetCase, answer: &FleetAnswer, seconds: f64) -> FleetRow {
    let ids = |causes: &[crate::diagnose::fleet::answer::CauseAnswer]| -> Vec<String> {
        causes.iter().map(|cause| cause.id.clone()).collect()
    };
    let truth = case.shared.as_ref().and_then(|set| set.iter().next());
    let held = truth.map_or_else(Vec::new, |(id, slots)| {
        let cause = answer.shared.iter().find(|cause| cause.id == id.name());
        let numbers = cause.map_or(&[][..], |cause| &cause.numbers);
        let slot = |name: &str| {
            id.spec().slots().find(|slot| {
                let own = slot.parameter.name;
                name == own || name == format!("{own}[{}]", slot.component)
            })
        };
        let holds = |number: &crate::diagnose::fleet::answer::FleetNumber| {
            let [low, high] = number.interval;
            let value = slots[slot(&number.name)?.index];
            Some((low..=high).contains(&value))
        };
        numbers.iter().filter_map(holds).collect()
    });
    let of_vehicle =
        |(answer, vehicle): (&VehicleAnswer, &crate::exam::fleet::FleetVehicle)| VehicleRow {
            name: answer.name.clone(),
            own: vehicle.own.map(|id| id.name().to_owned()),
            named: answer.effects.iter().map(|effect| effect.id.clone()).collect(),
            ambiguous_with: answer.ambiguous_with.clone(),
            state: answer.state,
        };
    FleetRow {
        name: name.to_owned(),
        file: case.file,
        on_board: case.on_board,
        shared: truth.map(|(id, _)| id.name().to_owned()),
        named: ids(&answer.shared),
        groups: ids(&answer.groups).into_iter().chain(ids(&answer.open)).collect(),
        held,
        vehicles: answer.vehicles.iter().zip(&case.vehicles).map(of_vehicle).collect(),
        seconds,
    }
}

fn text(summary: &FleetsSummary<'_>) -> String {
    let mut text = format!(
        "{:10} {:22} {:18} {:>9} {:>9} {:>6}  named\n",
        "fleet", "loop", "shared", "own", "invented", "s"
    );
    for row in summary.cases {
        let own = Rate::of(row.vehicles.iter().filter_map(VehicleRow::is_named));
        let intact = row.vehicles.iter().filter(|vehicle| vehicle.own.is_none());
        let invented = Rate::of(intact.map(|vehicle| !vehicle.named.is_empty()));
        text += &format!(
            "{:10} {:22} {:18} {:>9} {:>9} {:>6.0}  {}{}\n",
            row.name,
            row.on_board.name(),
            row.shared.as_deref().unwrap_or("none"),
            format!("{} of {}", own.count, own.of),
            format!("{} of {}", invented.count, invented.of),
            row.seconds,
            row.named.join(", "),
            if row.groups.is_empty() {
                String::new()
            } else {
                format!(" ({})", row.groups.join(", "))
            },
        );
    }
    for (what, rate) in [
        ("shared effects named, and nothing else", summary.shared),
        ("shared effects named", summary.shared_named),
        ("90 % intervals that hold the shared number", summary.intervals),
        ("fleets without one where one was invented", summary.invented),
        ("damaged vehicles whose own effect was named", summary.own),
        ("intact vehicles with an invented effect", summary.own_invented),
    ] {
        let [low, high] = rate.interval.map(|end| 100.0 * end);
        text +=
            &format!("{what:44} {} of {} (95 %: {low:.0} to {high:.0} %)\n", rate.count, rate.of);
    }
    text
}
