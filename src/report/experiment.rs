//! The page of the whole experiment: learn, plan, fly, compare.

use std::path::Path;

use vehicle::effects::EffectSet;
use vehicle::frame::Ned;

use super::axis::significant;
use super::chart::{Chart, Curve, Panel, Style};
use super::comparison::{Contender, Instant};
use super::page::{Mood, Page};
use super::scene::Scene;
use super::table::{Table, definitions};
use super::text::{beside, effects, length};
use super::training;
use crate::learn::summary::TrainingSummary;

const TIME: &str = "time since the start of the trajectory (s)";
/// The accelerations of the paper's figure: roll, and along y.
const SHOWN: [usize; 2] = [3, 1];

/// What the page is about.
pub struct Experiment<'a> {
    /// Name of the desired trajectory.
    pub trajectory: &'a str,
    /// Name of the vehicle.
    pub vehicle: &'a str,
    /// What the simulated vehicle has and the vehicle file does not.
    pub effects: &'a EffectSet,
    /// The training, where a model was learned.
    pub training: Option<&'a TrainingSummary>,
    /// The controllers; the first is what the others are compared with.
    pub contenders: &'a [Contender],
    /// Logs, plans and models, with what they are.
    pub files: &'a [(String, &'a Path)],
    /// The page's folder, from which they are named.
    pub folder: &'a Path,
    /// How it was computed.
    pub notes: &'a [(&'a str, String)],
}

/// The whole page, self-contained.
pub fn html(experiment: &Experiment<'_>) -> String {
    let mut page = Page::new(
        &format!("Experiment: {}", experiment.trajectory),
        &format!("simulated vehicle {} with {}", experiment.vehicle, effects(experiment.effects)),
    );
    verdict(experiment, &mut page);
    page.section(
        "Comparison",
        "Mean position error over the flights, against the desired trajectory whatever the \
         reference was. Feedback's share is its share of the input beyond hover.",
        &comparison(experiment),
    );
    if let Some(summary) = experiment.training {
        page.section(
            "Observed and predicted accelerations",
            "A test flight, which no model was trained on.",
            &training::series(summary, &SHOWN),
        );
    }
    page.section(
        "Trajectories",
        "The first flight of each controller, to scale, seen from the south-west.",
        &trajectories(experiment.contenders),
    );
    page.section(
        "Tracking error",
        "Absolute error against the desired trajectory, first flight of each controller.",
        &errors(experiment.contenders),
    );
    page.section(
        "Open loop and feedback",
        "Root mean square of the input's parts: the reference's input beyond hover at the desired \
         yaw, and the feedback's.",
        &shares(experiment),
    );
    let files: Vec<(String, String)> = experiment
        .files
        .iter()
        .map(|(what, path)| (what.clone(), beside(path, experiment.folder)))
        .collect();
    let files = definitions(files.iter().map(|(what, path)| (what.as_str(), path.as_str())));
    page.section("Files", "", &files);
    let notes = experiment.notes.iter().map(|(term, text)| (*term, text.as_str()));
    page.section("How this was computed", "", &definitions(notes));
    page.into_html()
}

fn verdict(experiment: &Experiment<'_>, page: &mut Page) {
    let Some((first, others)) = experiment.contenders.split_first() else { return };
    let mut figures: Vec<(String, String, Mood)> = experiment
        .contenders
        .iter()
        .map(|c| (format!("RMS error, {}", c.name), length(c.mean.rmse_3d_m), Mood::Plain))
        .collect();
    let best = others.iter().min_by(|a, b| a.mean.rmse_3d_m.total_cmp(&b.mean.rmse_3d_m));
    match best {
        Some(best) => {
            let gain = first.mean.rmse_3d_m / best.mean.rmse_3d_m;
            let sentence = format!(
                "Planned with the {} model, the flight stays {} RMS from the desired trajectory; \
                 {} {}: {:.1} times as far.",
                best.name,
                length(best.mean.rmse_3d_m),
                first.name,
                length(first.mean.rmse_3d_m),
                gain
            );
            let mood = if gain >= 1.0 { Mood::Good } else { Mood::Warning };
            page.verdict(mood, &sentence, &[]);
            figures.push(("gain".to_owned(), format!("{gain:.1} times"), mood));
        }
        None => {
            let error = length(first.mean.rmse_3d_m);
            page.verdict(Mood::Plain, &format!("{}: {error} RMS.", first.name), &[]);
        }
    }
    let figures: Vec<(&str, String, Mood)> =
        figures.iter().map(|(name, value, mood)| (name.as_str(), value.clone(), *mood)).collect();
    page.figures(&figures);
}

fn comparison(experiment: &Experiment<'_>) -> String {
    let mut table = Table::new(&[
        ("controller", false),
        ("flights", true),
        ("north (m)", true),
        ("east (m)", true),
        ("down (m)", true),
        ("3D (m)", true),
        ("greatest (m)", true),
        ("yaw (deg)", true),
        ("model-free over this", true),
        ("feedback's share", true),
    ]);
    let reference = experiment.contenders.first().map_or(f64::NAN, |c| c.mean.rmse_3d_m);
    for contender in experiment.contenders {
        let mean = &contender.mean;
        let [n, e, d] = mean.rmse_ned_m;
        let mut cells = vec![contender.name.clone(), contender.flights.len().to_string()];
        cells.extend([n, e, d, mean.rmse_3d_m, mean.max_3d_m].map(|v| format!("{v:.4}")));
        cells.push(format!("{:.2}", mean.rmse_yaw_rad.to_degrees()));
        cells.push(format!("{:.1}", reference / mean.rmse_3d_m));
        cells.push(format!("{:.0} %", 100.0 * contender.share.feedback_share));
        table.row(Mood::Plain, &cells);
    }
    table.into_html()
}

/// The first flight of each controller, drawn.
pub(super) fn trajectories(contenders: &[Contender]) -> String {
    let flown: Vec<(&str, Vec<Ned>)> = contenders
        .iter()
        .map(|c| (c.name.as_str(), c.first.instants.iter().map(|i| i.flown).collect()))
        .collect();
    let paths: Vec<(&str, &[Ned])> =
        flown.iter().map(|(name, path)| (*name, path.as_slice())).collect();
    let desired: Vec<Ned> = contenders
        .first()
        .map(|c| c.first.instants.iter().map(|i| i.desired).collect())
        .unwrap_or_default();
    Scene { paths: &paths, desired: &desired }.to_html()
}

/// Curves of a figure for every controller, on the ticks of the first.
fn panel(contenders: &[Contender], name: &str, value: impl Fn(&Instant) -> f64) -> Panel {
    let ticks = contenders.first().map_or(0, |c| c.first.instants.len());
    let curves = contenders.iter().enumerate().map(|(place, contender)| {
        let mut y: Vec<f64> = contender.first.instants.iter().map(&value).collect();
        y.resize(ticks, f64::NAN);
        Curve { name: contender.name.clone(), style: Style::of(&contender.name, place), y }
    });
    Panel { name: name.to_owned(), curves: curves.collect() }
}

/// The tracking error over time, first flight of each controller.
pub(super) fn errors(contenders: &[Contender]) -> String {
    let Some(first) = contenders.first() else { return String::new() };
    let time: Vec<f64> = first.first.instants.iter().map(|i| i.time_s).collect();
    let axis = |axis: usize| move |i: &Instant| (i.flown - i.desired).to_array()[axis].abs();
    let panels = vec![
        panel(contenders, "north (m)", axis(0)),
        panel(contenders, "east (m)", axis(1)),
        panel(contenders, "down (m)", axis(2)),
        panel(contenders, "distance (m)", |i| (i.flown - i.desired).norm()),
        panel(contenders, "yaw (deg)", |i| i.yaw_error_rad.abs().to_degrees()),
    ];
    Chart::new(TIME, &time, 100.0, panels).to_html()
}

fn shares(experiment: &Experiment<'_>) -> String {
    let mut table = Table::new(&[
        ("controller", false),
        ("part", false),
        ("thrust (N)", true),
        ("roll (deg)", true),
        ("pitch (deg)", true),
        ("yaw (deg)", true),
        ("roll rate (deg/s)", true),
        ("pitch rate (deg/s)", true),
        ("yaw rate (deg/s)", true),
    ]);
    for contender in experiment.contenders {
        let share = &contender.share;
        for (part, rms) in [("open loop", share.open_loop_rms), ("feedback", share.feedback_rms)] {
            let [thrust, angles @ ..] = rms;
            let mut cells = vec![contender.name.clone(), part.to_owned(), significant(thrust)];
            cells.extend(angles.map(|angle| format!("{:.2}", angle.to_degrees())));
            table.row(Mood::Plain, &cells);
        }
    }
    table.into_html()
}
