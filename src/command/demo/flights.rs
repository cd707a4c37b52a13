//! The flights of the experiment: every course, with every seed.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use std::time::Instant;

use schemars::JsonSchema;
use serde::Serialize;

use super::Demo;
use crate::cli::Contestant;
use crate::command::course::Course;
use crate::command::progress::flight_bar;
use crate::command::simulation::{Simulated, SimulatedFlight};
use crate::command::{Exit, ExitContext, print_status, summary};
use crate::config::Config;
use crate::offboard::EffectiveVehicle;
use crate::report::comparison::{Contender, Track};
use crate::report::flight::FlightReport;
use crate::station::End;

/// One flight's log.
#[derive(JsonSchema, Serialize)]
pub(super) struct LogRow {
    pub contender: String,
    pub seed: u64,
    pub log: PathBuf,
}

/// The flights of a demo.
pub(super) struct Flown {
    /// The first flight, with all its records.
    pub first: FlightReport,
    pub end: String,
    pub exit: Exit,
    pub logs: Vec<LogRow>,
    pub contenders: Vec<Contender>,
    pub simulated_s: f64,
    pub wall_s: f64,
}

impl Demo<'_> {
    /// Flies every course with every seed; `None` if interrupted.
    pub(super) fn fly(&self, courses: &[(Contestant, Course)]) -> anyhow::Result<Option<Flown>> {
        let args = self.args;
        let hover_thrust_n = EffectiveVehicle::new(&self.vehicle.params)
            .or_exit(Exit::Usage)?
            .hover
            .hover_thrust_n();
        let length: f64 = courses.iter().map(|(_, course)| course.duration()).sum();
        let progress = flight_bar(length * (args.flights * self.configs.len() as u64) as f64);
        let mut flown = None;
        let mut before_s = 0.0;
        let began = Instant::now();
        let mut reading_s = 0.0;
        let laws = |course| self.configs.iter().map(move |config| (course, config));
        for ((contestant, course), config) in courses.iter().flat_map(laws) {
            let name = self.name(*contestant, config);
            let mut tracks = Vec::new();
            for seed in args.seed..args.seed.saturating_add(args.flights) {
                if self.interrupted.load(Ordering::Relaxed) {
                    return Ok(None);
                }
                let flight = SimulatedFlight {
                    config,
                    vehicle: &self.vehicle,
                    airframe: &self.vehicle.params,
                    truth: &self.truth,
                    course,
                    run: &self.run_name(course, &name, seed),
                    seed,
                    extra: BTreeMap::from([("reference".to_owned(), name.clone())]),
                };
                let Simulated { end, log, simulated_s } = flight.fly(&args.out, |status| {
                    let along_s = status.progress.map_or(0.0, |(t, _)| t);
                    progress.set_position(((before_s + along_s) * 10.0) as u64);
                    progress.set_message(format!(
                        "{name}: {}",
                        status.phase.map_or("connect", |phase| phase.name())
                    ));
                })?;
                before_s += course.duration();
                let reading = Instant::now();
                let report = summary::report_on(&log)?;
                if let Some(desired) = &self.desired {
                    let reference = course.at_start().reference(hover_thrust_n);
                    let track = Track::new(&report, desired, reference.as_ref(), hover_thrust_n);
                    tracks.extend((!track.is_empty()).then_some(track));
                }
                reading_s += reading.elapsed().as_secs_f64();
                let (text, exit) = summary::end_text(Some(&end), None);
                if end != End::Done {
                    print_status(format_args!("{name} did not end as planned: {text}"));
                }
                let all = flown.get_or_insert_with(|| Flown {
                    first: report,
                    end: text.clone(),
                    exit,
                    logs: Vec::new(),
                    contenders: Vec::new(),
                    simulated_s: 0.0,
                    wall_s: 0.0,
                });
                if all.exit == Exit::Ok {
                    (all.end, all.exit) = (text, exit);
                }
                all.simulated_s += simulated_s;
                all.logs.push(LogRow { contender: name.clone(), seed, log });
            }
            if let Some(all) = &mut flown {
                all.contenders.extend(Contender::new(&name, tracks));
            }
        }
        progress.finish_and_clear();
        Ok(flown.map(|flown| Flown { wall_s: began.elapsed().as_secs_f64() - reading_s, ..flown }))
    }

    /// The name of a row of the table: its course, and where laws are compared, the law.
    fn name(&self, contestant: Contestant, config: &Config) -> String {
        match self.configs.len() {
            1 => contestant.name().to_owned(),
            _ => format!("{} {}", contestant.name(), config.settings.control.law),
        }
    }

    /// The name of a flight, in its log and in the log's file name.
    fn run_name(&self, course: &Course, contender: &str, seed: u64) -> String {
        let mut name = course.name().to_owned();
        if self.args.fly.len() * self.configs.len() > 1 {
            name += &format!("-{}", contender.replace(' ', "-"));
        }
        if self.args.flights > 1 {
            name += &format!("-{seed}");
        }
        name
    }
}
