//! `downwash tube check`: counts new simulated flights that stay within a plan's tube.

use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use anyhow::anyhow;
use rayon::prelude::*;
use schemars::JsonSchema;
use serde::Serialize;
use vehicle::frame::Ned;

use super::ensemble::{Ensemble, Purpose};
use super::flown::Flown;
use crate::cli::TubeCheckArgs;
use crate::command::course::Course;
use crate::command::progress::count_bar;
use crate::command::simulation::Truth;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Exit, ExitContext, config, print_json, print_status, print_text};
use crate::exam::interval::Rate;
use crate::plan::keep_out::KeepOut;
use crate::plan::planned::{Plan, PlannedReference};
use crate::plan::reference::ReferenceSource;

/// Largest shortfall below the confidence that is attributed to chance, in standard deviations: one
/// check in a hundred exceeds it by chance.
const DEVIATIONS: f64 = 2.33;
/// Number of equal parts, by wind speed, in which the flights are also counted.
const PARTS: usize = 3;

/// Counts of the simulated flights: the JSON of `tube check`.
#[derive(Debug, JsonSchema, Serialize)]
pub struct TubeCheck {
    schema: &'static str,
    schema_version: u32,
    plan: PathBuf,
    seed: u64,
    /// Confidence of the plan's tube.
    confidence: f64,
    /// Number of calibration flights of the tube.
    calibration_flights: usize,
    /// Mean radius over the plan, m.
    radius_mean_m: f64,
    radius_max_m: f64,
    /// Flights that stayed within the tube from beginning to end.
    pub whole: Rate,
    /// Number of flights that ended early; they count as having left the tube.
    pub ended_early: usize,
    /// Number of keep-out regions.
    regions: usize,
    /// Flights that touched a region.
    pub touched: Rate,
    /// Least distance of a flight from a region, m; negative inside, null without regions.
    pub clearance_min_m: Option<f64>,
    /// The same flights in parts of equal size, by their steady wind. The confidence holds for all
    /// together, not for each part.
    by_wind: Vec<WindPart>,
}

/// The flights of one part.
#[derive(Debug, JsonSchema, Serialize)]
struct WindPart {
    /// Least and greatest horizontal speed of the steady wind, m/s.
    wind_m_s: [f64; 2],
    whole: Rate,
}

/// The result of one flight.
struct Outcome {
    is_whole: bool,
    is_complete: bool,
    wind_m_s: f64,
    clearance_m: Option<f64>,
}

pub(super) fn run(args: &TubeCheckArgs, stop: &AtomicBool) -> anyhow::Result<Exit> {
    let config = config::load(args.config.as_deref(), vec![])?;
    let vehicle = VehicleFile::chosen(args.vehicle.as_deref(), &config.settings)?;
    let base = Truth::load(&args.simulation, &vehicle.params)?;
    let plan = Arc::new(Plan::load(&args.plan).or_exit(Exit::Usage)?);
    let Some(tube) = &plan.tube else {
        return Err(anyhow!(
            "{}: the plan has no tube; make it with `downwash plan --tube FILE`",
            args.plan.display()
        ))
        .or_exit(Exit::Usage);
    };
    let course = Course::Planned(Arc::clone(&plan));
    course.check(&vehicle, &config)?;
    let ensemble = Ensemble { config: &config, vehicle: &vehicle, base: &base, seed: args.seed };
    let regions: Vec<KeepOut> =
        config.settings.plan.keep_out.iter().map(|region| (*region).into()).collect();
    let reference = PlannedReference::new(&plan);
    let bar = count_bar(args.flights.into());
    let done = AtomicU64::new(0);
    let outcomes: Vec<Option<Outcome>> = (0..u64::from(args.flights))
        .into_par_iter()
        .map(|number| {
            if stop.load(Ordering::Relaxed) {
                return Ok(None);
            }
            let courses = std::slice::from_ref(&course);
            let (flown, _) = ensemble.fly(Purpose::Check, number, courses, None)?;
            bar.set_position(done.fetch_add(1, Ordering::Relaxed) + 1);
            Ok(Some(Outcome {
                is_whole: flown.is_complete
                    && flown.share_of_radius().is_some_and(|share| share <= 1.0),
                is_complete: flown.is_complete,
                wind_m_s: flown.wind_m_s,
                clearance_m: clearance(&flown, &reference, &regions),
            }))
        })
        .collect::<anyhow::Result<_>>()?;
    bar.finish_and_clear();
    let mut outcomes: Vec<Outcome> = outcomes.into_iter().flatten().collect();
    outcomes.sort_by(|a, b| a.wind_m_s.total_cmp(&b.wind_m_s));
    let least = outcomes.iter().filter_map(|outcome| outcome.clearance_m).reduce(f64::min);
    let radii = &tube.radius_m;
    let check = TubeCheck {
        schema: "downwash.tube.check",
        schema_version: 1,
        plan: args.plan.clone(),
        seed: args.seed,
        confidence: tube.confidence,
        calibration_flights: tube.flights,
        radius_mean_m: radii.iter().sum::<f64>() / radii.len() as f64,
        radius_max_m: radii.iter().copied().fold(0.0, f64::max),
        whole: Rate::of(outcomes.iter().map(|outcome| outcome.is_whole)),
        ended_early: outcomes.iter().filter(|outcome| !outcome.is_complete).count(),
        regions: regions.len(),
        touched: Rate::of(outcomes.iter().map(|o| o.clearance_m.is_some_and(|c| c <= 0.0))),
        clearance_min_m: least,
        by_wind: outcomes
            .chunks(outcomes.len().div_ceil(PARTS).max(1))
            .map(|part| WindPart {
                wind_m_s: [&part[0], &part[part.len() - 1]].map(|outcome| outcome.wind_m_s),
                whole: Rate::of(part.iter().map(|outcome| outcome.is_whole)),
            })
            .collect(),
    };
    if args.json {
        print_json(&check)?;
    } else {
        print_text(&check.text())?;
    }
    if stop.load(Ordering::Relaxed) {
        return Ok(Exit::Interrupted);
    }
    let is_short = check.is_short();
    if is_short {
        print_status(format_args!(
            "fewer flights stayed within the tube than its confidence allows"
        ));
    }
    Ok(if is_short || check.touched.count > 0 { Exit::Check } else { Exit::Ok })
}

/// Least distance of the flown path from the regions, which are relative to the plan's origin, m.
fn clearance(flown: &Flown, reference: &PlannedReference, regions: &[KeepOut]) -> Option<f64> {
    // In the plan's axes: the flown reference is shifted to the vehicle's take-off position.
    let places: Vec<Ned> = flown
        .points
        .iter()
        .map(|p| p.flown - (p.planned - reference.sample(p.time_s).position))
        .collect();
    let steps = places.windows(2).flat_map(|pair| {
        let [from, to] = [pair[0], pair[1]].map(|place| place.to_array());
        regions.iter().map(move |region| -region.depth_between(from, to))
    });
    steps.reduce(f64::min)
}

impl TubeCheck {
    /// Whether fewer flights stayed within the tube than chance explains, in these flights and in
    /// the calibration flights. At a confidence c the count of N flights has a mean of c N and a
    /// variance of c (1 - c) (N + N^2 / (n + 2)), where n is the number of calibration flights.
    fn is_short(&self) -> bool {
        let flights = self.whole.of as f64;
        let calibrated = self.calibration_flights as f64 + 2.0;
        let single = self.confidence * (1.0 - self.confidence);
        let deviation = (single * (1.0 / flights + 1.0 / calibrated)).sqrt();
        self.whole.rate.is_some_and(|rate| rate < self.confidence - DEVIATIONS * deviation)
    }

    fn text(&self) -> String {
        let rate = |rate: &Rate| {
            let [low, high] = rate.interval.map(|bound| 100.0 * bound);
            let share = 100.0 * rate.rate.unwrap_or(f64::NAN);
            format!("{} of {}: {share:.1} % ({low:.1} to {high:.1})", rate.count, rate.of)
        };
        let mut text = format!(
            "tube        {:.0} %, {:.3} m on average, {:.3} m at most, from {} flights\n\
             whole       {}\n",
            100.0 * self.confidence,
            self.radius_mean_m,
            self.radius_max_m,
            self.calibration_flights,
            rate(&self.whole)
        );
        if self.ended_early > 0 {
            text += &format!("ended early {}\n", self.ended_early);
        }
        if let Some(clearance_m) = self.clearance_min_m {
            text += &format!("touched     {}\n", rate(&self.touched));
            text += &format!("clearance   {clearance_m:.3} m minimum\n");
        }
        for part in &self.by_wind {
            let [low, high] = part.wind_m_s;
            text += &format!("wind {low:.2} to {high:.2} m/s   {}\n", rate(&part.whole));
        }
        text
    }
}
