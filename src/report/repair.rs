//! The page of the loop closed: a hidden effect, its diagnosis, and what the improved vehicle file
//! is worth to the next flight.

use std::path::Path;

use vehicle::effects::EffectSet;

use super::axis::significant;
use super::comparison::Contender;
use super::experiment::{errors, trajectories};
use super::page::{Mood, Page};
use super::table::{Table, definitions};
use super::text::{beside, effects};

/// What the page is about.
pub struct Repair<'a> {
    /// Name of the desired trajectory.
    pub trajectory: &'a str,
    /// Name of the vehicle.
    pub vehicle: &'a str,
    /// What the simulated vehicle has and the vehicle file does not say.
    pub hidden: &'a EffectSet,
    /// What was found.
    pub finding: &'a str,
    /// The gap on the flights along the trajectory, in units of the noise: as shipped, improved,
    /// and of noise alone.
    pub gap: Option<[f64; 3]>,
    /// Flights planned and controlled with the file as shipped, then with the improved one.
    pub contenders: &'a [Contender],
    /// Files, with what they are.
    pub files: &'a [(String, &'a Path)],
    /// The page's folder, from which they are named.
    pub folder: &'a Path,
    /// How it was computed.
    pub notes: &'a [(&'a str, String)],
}

/// The whole page, self-contained.
pub fn html(repair: &Repair<'_>) -> String {
    let mut page = Page::new(
        &format!("The loop closed: {}", repair.trajectory),
        &format!("simulated vehicle {} with {}", repair.vehicle, effects(repair.hidden)),
    );
    page.verdict(Mood::Plain, repair.finding, &[]);
    let mut figures: Vec<(String, String, Mood)> = Vec::new();
    if let Some([before, after, _]) = repair.gap {
        figures.push(("gap as shipped".to_owned(), significant(before), Mood::Plain));
        figures.push(("gap improved".to_owned(), significant(after), Mood::Good));
    }
    for contender in repair.contenders {
        let error = format!("{} m", significant(contender.mean.rmse_3d_m));
        figures.push((format!("RMS error, {}", contender.name), error, Mood::Plain));
    }
    let shown: Vec<(&str, String, Mood)> =
        figures.iter().map(|(name, value, mood)| (name.as_str(), value.clone(), *mood)).collect();
    page.figures(&shown);
    page.section(
        "Before and after",
        "The gap is the error of open-loop predictions of the flights along the trajectory, as a \
         multiple of the noise floor. Tracking errors are against the desired trajectory.",
        &table(repair),
    );
    page.section(
        "Trajectories",
        "The first flight of each, to scale, seen from the south-west.",
        &trajectories(repair.contenders),
    );
    page.section(
        "Tracking error",
        "Absolute error against the desired trajectory, first flight of each.",
        &errors(repair.contenders),
    );
    let files: Vec<(String, String)> = repair
        .files
        .iter()
        .map(|(what, path)| (what.clone(), beside(path, repair.folder)))
        .collect();
    let files = definitions(files.iter().map(|(what, path)| (what.as_str(), path.as_str())));
    page.section("Files", "", &files);
    let notes = repair.notes.iter().map(|(term, text)| (*term, text.as_str()));
    page.section("How this was computed", "", &definitions(notes));
    page.into_html()
}

fn table(repair: &Repair<'_>) -> String {
    let mut columns = vec![("", false)];
    columns.extend(repair.contenders.iter().map(|contender| (contender.name.as_str(), true)));
    let mut table = Table::new(&columns);
    let mut row = |name: &str, values: Vec<String>| {
        let mut cells = vec![name.to_owned()];
        cells.extend(values);
        table.row(Mood::Plain, &cells);
    };
    if let Some([before, after, _]) = repair.gap
        && repair.contenders.len() == 2
    {
        row("gap, times the noise floor", vec![significant(before), significant(after)]);
    }
    let of = |value: fn(&Contender) -> f64| -> Vec<String> {
        repair.contenders.iter().map(|contender| significant(value(contender))).collect()
    };
    row("position error, RMS (m)", of(|c| c.mean.rmse_3d_m));
    row("greatest position error (m)", of(|c| c.mean.max_3d_m));
    row("yaw error, RMS (deg)", of(|c| c.mean.rmse_yaw_rad.to_degrees()));
    row("feedback's share of the input (%)", of(|c| 100.0 * c.share.feedback_share));
    table.into_html()
}
