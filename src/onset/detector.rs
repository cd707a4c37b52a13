//! The change detector: samples in, changes out.

mod estimate;

use std::collections::VecDeque;

use vehicle::{VehicleError, VehicleParams};

use self::estimate::peak;
use super::cells::{CELL_S, Cell, Cells, Piece, Sample};
use super::change::Change;
use super::columns::{COLUMNS, Cause, DIRECTIONS, DRIFT};
use super::likelihood::{Grid, Profile, Scale, Window};
use super::noise::{Autoregression, COHERENT, LawErrors, Noise, ORDER, Spectrum};

/// Cells that are examined together: half a minute.
const WINDOW: usize = 600;
/// Cells before a change, enough to know the vehicle's state before it: 8 s.
const BEFORE: usize = 160;
/// Cells after a change: 0.3 to 12 s.
const AFTER: [usize; 2] = [6, 240];
/// Cells by which the noise estimate lags: a change would be detected by then.
const LATE: usize = 120;
/// Cells between updates of the noise: 5 s.
const RENEWED: usize = 100;
/// Cells after a candidate onset at which its statistic is sampled under no change: 1, 2 and 4 s.
const CHANCE_AFTER: [usize; 3] = [20, 40, 80];
/// Cells between two such samples.
const CHANCE_EVERY: usize = 20;
/// Prior weight of a noise scale of 1, and the largest weight of the past, in looks.
const LOOKS: [f64; 2] = [15.0, 60.0];

/// The detection threshold and the delay of reports.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Mean time between false alarms for which the threshold is set, if the noise model is
    /// correct, h.
    pub false_alarm_h: f64,
    /// Delay of the report of a change after its onset, s.
    pub hindsight_s: f64,
    /// Cells between looks.
    pub every: usize,
}

impl Settings {
    /// In flight: reports after two seconds.
    pub const LIVE: Self = Self { false_alarm_h: 1000.0, hindsight_s: 2.0, every: 10 };
    /// From a log: reports once five seconds after the change are available.
    pub const LOG: Self = Self { hindsight_s: 5.0, ..Self::LIVE };

    /// Evidence threshold for a change, nats: that of a Bayes factor whose inverse bounds the rate
    /// of false alarms over looks and causes (Shiryaev 1963, Roberts 1966).
    pub fn bound(&self) -> f64 {
        let looks = self.false_alarm_h.max(0.01) * 3600.0 / (self.every as f64 * CELL_S);
        (looks * Cause::ALL.len() as f64).ln()
    }
}

/// Output of a detector.
#[derive(Clone, Debug)]
pub enum Event {
    /// A look at the last seconds.
    Look(Look),
    /// A change.
    Change(Box<Change>),
}

/// The present evidence for a change.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Time of the look, s.
    pub time_s: f64,
    /// The cause with the most evidence.
    pub cause: Cause,
    /// Its evidence, nats.
    pub evidence: f64,
    /// Whether an alarm is active and its report pending.
    pub is_alarmed: bool,
}

/// The vehicle's parameters over the last seconds along each direction, with standard deviations,
/// in its unit.
pub type Present = [[f64; 2]; DIRECTIONS.len()];

/// The change detector of one vehicle.
#[derive(Clone, Debug)]
pub struct Detector {
    settings: Settings,
    cells: Cells,
    kept: VecDeque<Cell>,
    spectrum: Spectrum,
    law_errors: LawErrors,
    noise: Noise,
    window: Window,
    /// The parameters relative to which the residuals for the noise are computed.
    parameters: Option<[f64; COLUMNS]>,
    /// Number of kept cells that the noise estimate already includes.
    noted: usize,
    /// Cells since the noise was updated, and since a look.
    renewed: usize,
    looked: usize,
    /// Count of cells when the statistics were last sampled.
    sampled: usize,
    /// Sums of statistics and their count, by cause; and the pending samples.
    statistics: [[f64; 2]; Cause::ALL.len()],
    waiting: VecDeque<(usize, [f64; Cause::ALL.len()])>,
    count: usize,
    /// Time of the active alarm, s.
    alarm: Option<f64>,
}

impl Detector {
    /// A detector for a vehicle.
    ///
    /// # Errors
    /// The physics rejects the vehicle.
    pub fn new(vehicle: &VehicleParams, settings: Settings) -> Result<Self, VehicleError> {
        Ok(Self {
            settings,
            cells: Cells::new(vehicle)?,
            kept: VecDeque::with_capacity(WINDOW + ORDER + 1),
            spectrum: Spectrum::new(CELL_S),
            law_errors: LawErrors::new(),
            noise: Noise::NONE,
            window: Window::default(),
            parameters: None,
            noted: 0,
            renewed: 0,
            looked: 0,
            sampled: 0,
            statistics: [[0.0; 2]; Cause::ALL.len()],
            waiting: VecDeque::new(),
            count: 0,
            alarm: None,
        })
    }

    /// Adds a sample at `time`, s of the vehicle's clock; calls `on_event` with the resulting
    /// events.
    pub fn push(&mut self, time: f64, sample: Sample, mut on_event: impl FnMut(Event)) {
        self.cells.push(time, sample);
        while let Some(piece) = self.cells.next_piece() {
            match piece {
                Piece::Pause => self.pause(&mut on_event),
                Piece::Cell(cell) => self.cell(*cell, &mut on_event),
            }
        }
    }

    /// Ends the flight: reports a pending change.
    pub fn finish(&mut self, mut on_event: impl FnMut(Event)) {
        self.pause(&mut on_event);
    }

    /// The vehicle's parameters over the last half minute, with standard deviations, as differences
    /// from the file.
    pub fn present(&self) -> Option<Present> {
        let mut along = self.window.along_directions().filter(|_| self.window.len() >= BEFORE)?;
        for (direction, pair) in along.iter_mut().enumerate() {
            *pair = pair.map(|number| number * self.cells.sizes().direction(direction));
        }
        Some(along)
    }

    fn pause(&mut self, on_event: &mut impl FnMut(Event)) {
        if let Some(change) = self.alarm.and_then(|alarm| self.change(alarm)) {
            on_event(Event::Change(Box::new(change)));
        }
        self.alarm = None;
        self.kept.clear();
        self.window = Window::default();
        self.waiting.clear();
        self.spectrum.pause();
        self.noted = 0;
    }

    fn cell(&mut self, cell: Cell, on_event: &mut impl FnMut(Event)) {
        let now = cell.time + CELL_S;
        self.count += 1;
        self.kept.push_back(cell);
        if self.kept.len() > WINDOW + ORDER {
            self.kept.pop_front();
            self.noted = self.noted.saturating_sub(1);
            self.window.forget();
        }
        if self.parameters.is_none() {
            if self.kept.len() >= BEFORE + ORDER {
                self.begin();
            }
            return;
        }
        if self.kept.len() > ORDER {
            let parameters = self.reference();
            self.window.push(&self.kept, self.kept.len() - 1, &self.noise, &parameters);
        }
        if self.alarm.is_none() {
            self.note(LATE);
        }
        self.renewed += 1;
        if self.renewed >= RENEWED {
            self.renew();
        }
        self.looked += 1;
        if self.looked >= self.settings.every && self.window.len() >= BEFORE + AFTER[0] {
            self.looked = 0;
            self.look(now, on_event);
        }
    }

    /// The first noise estimate: the residual of parameters fitted under white noise.
    fn begin(&mut self) {
        let white = |equation: usize| {
            let residual = || self.kept.iter().map(|cell| cell.rows[equation].residual);
            let present = || residual().filter(|residual| residual.is_finite());
            let count = present().count() as f64;
            let mean = present().sum::<f64>() / count;
            let variance = present().map(|residual| (residual - mean).powi(2)).sum::<f64>() / count;
            (count > 2.0 && variance > 0.0)
                .then_some(Autoregression { coefficients: [0.0; ORDER], variance })
        };
        self.noise.filters = std::array::from_fn(white);
        self.window = Window::of(&self.kept, &self.noise, &self.reference());
        self.parameters = self.window.parameters();
        self.note(0);
        self.renew();
    }

    /// Adds cells at least `late` cells old to the noise estimate.
    fn note(&mut self, late: usize) {
        let Some(parameters) = self.parameters else { return };
        while self.noted + late < self.kept.len() {
            let cell = &self.kept[self.noted];
            let residual = std::array::from_fn(|equation| unexplained(cell, equation, &parameters));
            self.spectrum.add(&residual);
            if self.noted >= ORDER && late > 0 {
                self.note_laws(&parameters);
            }
            self.noted += 1;
        }
    }

    /// Adds the same cell, whitened, to the estimate of the laws' errors.
    fn note_laws(&mut self, parameters: &[f64; COLUMNS]) {
        for (equation, filter) in self.noise.filters.iter().enumerate() {
            let Some(filter) = filter else { continue };
            let at = |back: usize| &self.kept[self.noted - back];
            let mut residual = unexplained(at(0), equation, parameters);
            let mut model = at(0).rows[equation].model;
            for (j, coefficient) in filter.coefficients.iter().enumerate() {
                residual -= coefficient * unexplained(at(j + 1), equation, parameters);
                model -= coefficient * at(j + 1).rows[equation].model;
            }
            if residual.is_finite() {
                self.law_errors.add(equation, residual, model, filter.variance);
            }
        }
    }

    /// Updates the noise, and whitens the window with it.
    fn renew(&mut self) {
        self.renewed = 0;
        self.noise = Noise {
            filters: std::array::from_fn(|equation| {
                let least = COHERENT as f64 * self.cells.sizes().least(equation).powi(2);
                self.spectrum.autoregression(equation, least)
            }),
            law: std::array::from_fn(|equation| self.law_errors.variance(equation)),
        };
        self.window = Window::of(&self.kept, &self.noise, &self.reference());
        if self.alarm.is_none()
            && self.window.len() >= BEFORE
            && let Some(parameters) = self.window.parameters()
        {
            self.parameters = Some(parameters);
        }
    }

    /// The parameters relative to which cells are whitened; the file's before the first estimate.
    fn reference(&self) -> [f64; COLUMNS] {
        self.parameters.unwrap_or([0.0; COLUMNS])
    }

    fn scales(&self) -> [Scale; Cause::ALL.len()] {
        self.statistics.map(|[sum, count]| {
            // Neighbouring looks share half of their data.
            let looks = LOOKS[0] + 0.5 * count;
            let variance = (LOOKS[0] + 0.5 * sum) / looks;
            Scale { variance: variance.max(1.0), looks }
        })
    }

    fn profiles(&self, grid: Grid) -> Vec<Profile> {
        let last = AFTER[1].min(self.window.len().saturating_sub(BEFORE));
        self.window.profiles([AFTER[0], last], &self.scales(), grid)
    }

    fn look(&mut self, now: f64, on_event: &mut impl FnMut(Event)) {
        let profiles = self.profiles(Grid::Thinned);
        let best = profiles.iter().filter_map(|profile| Some((profile.cause, peak(profile)?)));
        let best = best.max_by(|a, b| a.1.evidence.total_cmp(&b.1.evidence));
        let Some((cause, place)) = best else { return };
        let (evidence, cell) = (place.evidence, place.cell);
        let is_alarmed = evidence >= self.settings.bound();
        self.alarm = if is_alarmed { self.alarm.or(Some(now)) } else { None };
        on_event(Event::Look(Look { time_s: now, cause, evidence, is_alarmed }));
        if let Some(alarm) = self.alarm {
            self.waiting.clear();
            let after = (self.window.len() - cell) as f64 * CELL_S;
            if after >= self.settings.hindsight_s
                && let Some(change) = self.change(alarm)
            {
                on_event(Event::Change(Box::new(change)));
                self.begin_anew(cell);
            }
            return;
        }
        if self.count >= self.sampled + CHANCE_EVERY {
            self.sampled = self.count;
            self.sample_chance(&profiles);
        }
    }

    /// Records the size of the statistics under no change.
    fn sample_chance(&mut self, profiles: &[Profile]) {
        let end = self.window.len();
        let mut means = [f64::NAN; Cause::ALL.len()];
        for (mean, profile) in means.iter_mut().zip(profiles) {
            let sampled = profile.places.iter().filter(|p| CHANCE_AFTER.contains(&(end - p.cell)));
            let (sum, count) = sampled.fold((0.0, 0.0), |(s, n), p| (s + p.statistic, n + 1.0));
            *mean = sum / count;
        }
        self.waiting.push_back((self.count, means));
        while self.waiting.front().is_some_and(|(at, _)| *at + LATE < self.count) {
            let Some((_, means)) = self.waiting.pop_front() else { break };
            for (of, mean) in self.statistics.iter_mut().zip(means) {
                if mean.is_finite() {
                    let keep = 1.0 - 1.0 / LOOKS[1];
                    *of = [of[0] * keep + mean, of[1] * keep + 1.0];
                }
            }
        }
    }

    /// After a change, only the data that follow it describe the vehicle.
    fn begin_anew(&mut self, cell: usize) {
        self.kept.drain(..(cell + ORDER).min(self.kept.len()));
        self.noted = self.noted.saturating_sub(cell + ORDER);
        self.spectrum.pause();
        self.window = Window::of(&self.kept, &self.noise, &self.reference());
        self.waiting.clear();
        self.alarm = None;
    }
}

/// The residual of a cell's equation.
fn unexplained(cell: &Cell, equation: usize, parameters: &[f64; COLUMNS]) -> f64 {
    let row = &cell.rows[equation];
    let modelled = row.slopes[..DRIFT].iter().zip(parameters);
    row.residual - modelled.map(|(slope, number)| slope * number).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_pcg::Pcg64Mcg;
    use vehicle::frame::{Attitude, Frd, Ned};

    use super::*;

    /// A hover of `seconds`, reported at 100 Hz; the specific force is larger by a time-dependent
    /// fraction of gravity.
    fn detected(seconds: f64, seed: u64, share: impl Fn(f64) -> f64) -> Vec<Change> {
        let vehicle = VehicleParams::load("quad1200").expect("a vehicle");
        let mut detector = Detector::new(&vehicle, Settings::LOG).expect("a detector");
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let mut normal = move |deviation: f64| -> f64 {
            let z: f64 = StandardNormal.sample(&mut rng);
            deviation * z
        };
        let mut changes = Vec::new();
        let mut on_event = |event| {
            if let Event::Change(change) = event {
                changes.push(*change);
            }
        };
        let mut down = 0.0;
        for k in 0..(seconds * 100.0) as usize {
            let time = k as f64 * 0.01;
            down -= share(time) * vehicle.gravity * 0.01;
            let velocity = Ned::new(normal(0.01), normal(0.01), down + normal(0.01));
            let force = -vehicle.gravity * (1.0 + share(time)) + normal(0.1);
            let attitude = Attitude { w: 1.0, x: normal(5e-4), y: normal(5e-4), z: 0.0 };
            let outputs = std::array::from_fn(|_| vehicle.hover_thrust + normal(1e-3));
            for sample in [
                Sample::Velocity(velocity),
                Sample::Attitude(attitude.normalized()),
                Sample::BodyRate(Frd::new(normal(0.01), normal(0.01), normal(0.01))),
                Sample::SpecificForce(Frd::new(normal(0.1), normal(0.1), force)),
                Sample::Outputs(outputs),
            ] {
                detector.push(time, sample, &mut on_event);
            }
        }
        detector.finish(&mut on_event);
        changes
    }

    #[test]
    fn thrust_drop_is_reported_with_time_and_size() {
        let changes = detected(40.0, 1, |time| if time < 25.0 { 0.0 } else { -0.03 });
        assert_eq!(changes.len(), 1, "{changes:?}");
        let change = &changes[0];
        assert!((change.at_s - 25.0).abs() < 0.3, "{change:?}");
        assert_eq!(change.cause, Cause::Thrust, "{change:?}");
        let [low, high] = change.values[0].change.interval;
        assert!(low < -0.03 && -0.03 < high && high < -0.02, "{change:?}");
    }

    #[test]
    fn noise_offset_and_slow_sag_are_not_changes() {
        for seed in 0..3 {
            assert!(detected(60.0, seed, |_| 0.0).is_empty());
            assert!(detected(60.0, seed, |_| 0.05).is_empty());
            let sag = detected(60.0, seed, |time| -0.02 * time / 60.0);
            assert!(sag.is_empty(), "{sag:?}");
        }
    }

    #[test]
    fn impossible_samples_and_pauses_are_tolerated() {
        let vehicle = VehicleParams::load("quad1200").expect("a vehicle");
        let mut detector = Detector::new(&vehicle, Settings::LIVE).expect("a detector");
        for k in 0..4000 {
            let time = if k % 7 == 0 { f64::NAN } else { f64::from(k) * 0.01 };
            let bad = if k % 11 == 0 { f64::INFINITY } else { f64::from(k % 5) * 1e3 };
            detector.push(time, Sample::Velocity(Ned::new(bad, 0.0, f64::NAN)), |_| {});
            detector.push(time, Sample::Attitude(Attitude::default()), |_| {});
            detector.push(time, Sample::BodyRate(Frd::new(bad, bad, bad)), |_| {});
            detector.push(time, Sample::Outputs([bad, 0.5, 0.5, 0.5]), |_| {});
            if k % 1500 == 1499 {
                detector.push(time, Sample::Pause, |_| {});
            }
        }
        detector.finish(|_| {});
    }
}
