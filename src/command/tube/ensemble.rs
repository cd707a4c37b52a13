//! Simulated flights of one vehicle under random disturbances.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use vehicle::effects::{EffectId, EffectSet, Mass, RotorDrag};

use super::flown::{Flown, FlownGatherer};
use crate::command::course::Course;
use crate::command::simulation::{SimulatedFlight, Truth};
use crate::command::summary::end_text;
use crate::command::vehicle_file::VehicleFile;
use crate::command::{Exit, ExitContext};
use crate::config::Config;
use crate::exam::draw::Draw;

/// Standard deviation of the steady wind along each horizontal axis and along down, m/s.
const WIND_M_S: [f64; 2] = [0.6, 0.1];
/// Ranges of the gusts' standard deviation, m/s, their length, m, and their speed, m/s.
const GUSTS_M_S: [f64; 2] = [0.05, 0.5];
const GUST_LENGTH_M: [f64; 2] = [2.0, 10.0];
const GUST_SPEED_M_S: [f64; 2] = [1.0, 5.0];
/// Rotor drag over mass, 1/s, of a vehicle without the effect, and the range of the factor on drag.
const DRAG_PER_S: [f64; 2] = [0.3, 0.15];
const DRAG_FACTOR: [f64; 2] = [0.7, 1.4];
/// Ranges of the factors on mass and thrust.
const MASS_FACTOR: [f64; 2] = [0.98, 1.02];
const THRUST_FACTOR: [f64; 2] = [0.98, 1.02];

/// Use of an ensemble's flights; different uses share no flight.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Purpose {
    /// For the width of a tube.
    Calibration,
    /// For the shape of a tube.
    Shape,
    /// For the check of a tube.
    Check,
}

impl Purpose {
    fn first(self) -> u64 {
        match self {
            Self::Calibration => 0,
            Self::Shape => 1 << 40,
            Self::Check => 1 << 41,
        }
    }
}

/// Flights of one vehicle, under one configuration and one distribution of disturbances.
pub(super) struct Ensemble<'a> {
    pub config: &'a Config,
    pub vehicle: &'a VehicleFile,
    /// The simulated vehicle, to which each flight's disturbances are added.
    pub base: &'a Truth,
    pub seed: u64,
}

/// The random choices of one flight.
struct Drawn {
    truth: Truth,
    wind_m_s: f64,
    seed: u64,
    /// Selects the course, 0..1.
    course: f64,
}

impl Ensemble<'_> {
    fn draw(&self, purpose: Purpose, number: u64) -> anyhow::Result<Drawn> {
        let mut draw = Draw::new(self.seed, purpose.first() + number);
        let params = &self.vehicle.params;
        let [across, down] = WIND_M_S;
        let [north, east, down] =
            [across * draw.normal(), across * draw.normal(), down * draw.normal()];
        let base = &self.base.effects;
        let mass = base.get::<Mass>().map_or(params.mass, |mass| mass.mass_kg);
        let known = base.get::<RotorDrag>().or(params.modelled_effects.get());
        let drag = known.map_or(DRAG_PER_S.map(|drag| drag * mass), |drag| [drag.d_xy, drag.d_z]);
        let drag = drag.map(|drag| drag * draw.log_within(DRAG_FACTOR));
        let thrust = base.value(EffectId::ThrustScale, "scale", 0).unwrap_or(1.0);
        let mut drawn = EffectSet::new();
        for effect in [
            format!("wind:north_m_s={north},east_m_s={east},down_m_s={down}"),
            format!(
                "gusts:sigma_m_s={},length_m={},speed_m_s={}",
                draw.within(GUSTS_M_S),
                draw.log_within(GUST_LENGTH_M),
                draw.within(GUST_SPEED_M_S)
            ),
            format!("rotor_drag:d_xy={},d_z={}", drag[0], drag[1]),
            format!("mass:mass_kg={}", mass * draw.within(MASS_FACTOR)),
            format!("thrust_scale:scale={}", thrust * draw.within(THRUST_FACTOR)),
        ] {
            drawn.insert_argument(&effect).or_exit(Exit::Usage)?;
        }
        Ok(Drawn {
            truth: Truth { effects: base.overlay(&drawn), ..self.base.clone() },
            wind_m_s: north.hypot(east),
            seed: draw.seed(),
            course: draw.within([0.0, 1.0]),
        })
    }

    /// Flies flight `number` along one of the courses, with a log if `folder` is given.
    pub fn fly(
        &self,
        purpose: Purpose,
        number: u64,
        courses: &[Course],
        folder: Option<&Path>,
    ) -> anyhow::Result<(Flown, Option<PathBuf>)> {
        let Drawn { truth, wind_m_s, seed, course } = self.draw(purpose, number)?;
        let last = courses.len().saturating_sub(1);
        let course = &courses[((course * courses.len() as f64) as usize).min(last)];
        let flight = SimulatedFlight {
            config: self.config,
            vehicle: self.vehicle,
            airframe: &self.vehicle.params,
            truth: &truth,
            course,
            run: course.name(),
            seed,
            extra: BTreeMap::new(),
        };
        let mut gatherer = FlownGatherer::default();
        let (end, log) = match folder {
            Some(folder) => {
                let flown = flight.fly_logged(
                    folder,
                    |record| {
                        gatherer.on_record(record);
                        None
                    },
                    |_| {},
                )?;
                (flown.end, Some(flown.log))
            }
            None => (flight.fly_unlogged(|record| gatherer.on_record(&record), |_| {})?.0, None),
        };
        let is_done = end_text(Some(&end), None).1 == Exit::Ok;
        let flown = gatherer.flown();
        let flown =
            Flown { mission: course.name().to_owned(), wind_m_s, is_complete: is_done, ..flown };
        Ok((flown, log))
    }
}
