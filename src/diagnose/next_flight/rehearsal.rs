//! Flies a manoeuvre in simulation with one hypothesis true, and fits the others to it.

use vehicle::effects::{EffectId, EffectSet};
use vehicle::frame::{Euler, Ned};
use vehicle::physics::Physics;
use vehicle::rigid_body::State;

use super::{LiveHypothesis, Proposal};
use crate::diagnose::catalogue::hypothesis::Catalogue;
use crate::diagnose::catalogue::number::Target;
use crate::diagnose::flights::preparation::PreparedFlight;
use crate::diagnose::likelihood::fit::fit;
use crate::diagnose::likelihood::linearised::Linearised;
use crate::diagnose::likelihood::observed::Observed;
use crate::diagnose::likelihood::residuals::Evaluator;
use crate::diagnose::simulate::flight_simulator::{
    Departure, FlightSimulator, GroundControl, NotSimulated,
};
use crate::log::import::Flight;
use crate::plan::ModelFreeReference;
use crate::plan::manoeuvres::Manoeuvre;
use crate::plan::reference::ReferenceSource;
use crate::setpoint::Reference;

/// Time of hover before the manoeuvre, for the vehicle to settle, s.
const LEAD_S: f64 = 4.0;
/// Period of the controller's ticks, s.
const TICK_S: f64 = 0.01;
/// Largest safe tilt, rad.
const TILT_MAX_RAD: f64 = 0.75;
/// Largest share of the time with a motor output at a stop.
const SATURATED_MAX: f64 = 0.01;
/// Outputs beyond these are at a stop.
const OUTPUT_STOPS: [f64; 2] = [0.001, 0.999];
/// Largest distance that a vehicle that differs from its file may stray beyond the manoeuvre's own
/// radius and height, m; and its least height, as a share of the lowest reference.
const STRAY_MAX_M: f64 = 1.5;
const HEIGHT_SHARE: f64 = 0.35;

/// The result of one flight if a hypothesis is true.
pub(super) struct Rehearsal {
    /// Index of that hypothesis.
    pub truth: usize,
    /// Evidence for it against each rival, nats.
    pub evidence: Vec<(usize, f64)>,
}

impl Rehearsal {
    /// The least evidence against a rival, nats.
    pub fn least(&self) -> f64 {
        self.evidence.iter().map(|(_, nats)| *nats).fold(f64::INFINITY, f64::min)
    }
}

/// A live hypothesis in terms of the catalogue.
struct PosedHypothesis {
    /// Indices of its hypotheses in the catalogue.
    own: Vec<usize>,
    /// Numbers with the values that its fit starts from.
    from: Vec<(usize, f64)>,
}

/// Inputs that all rehearsals share.
pub(super) struct Rehearsals<'a> {
    proposal: &'a Proposal<'a>,
    hypotheses: &'a [LiveHypothesis],
    control: GroundControl,
    catalogue: Catalogue,
    /// The hypotheses in terms of the catalogue.
    posed: Vec<PosedHypothesis>,
    /// Indices of the catalogue's nuisances.
    nuisances: Vec<usize>,
}

impl<'a> Rehearsals<'a> {
    pub fn new(
        proposal: &'a Proposal<'a>,
        hypotheses: &'a [LiveHypothesis],
    ) -> Result<Self, NotSimulated> {
        let catalogue = Catalogue::new(proposal.vehicle, proposal.setpoint_leg);
        let posed: Vec<PosedHypothesis> =
            hypotheses.iter().map(|live| PosedHypothesis::new(&catalogue, &live.effects)).collect();
        Ok(Self {
            control: GroundControl::new(proposal.vehicle)?,
            proposal,
            hypotheses,
            nuisances: catalogue.nuisances().collect(),
            catalogue,
            posed,
        })
    }

    /// Flies `manoeuvre` with hypothesis `truth` true, and fits all hypotheses to the flight;
    /// `None` if the vehicle breaks a limit, or nothing can be fitted.
    pub fn rehearse(&self, manoeuvre: &Manoeuvre, truth: usize) -> Option<Rehearsal> {
        let flight = self.fly(manoeuvre, &self.hypotheses[truth].effects)?;
        if !is_safe(&flight, manoeuvre) {
            return None;
        }
        let flights = [PreparedFlight::new(flight, self.proposal.vehicle).ok()?];
        let evaluator = Evaluator::new(self.proposal.vehicle).observing(&flights);
        let observed = Observed::new(&flights, &evaluator, &self.catalogue);
        let references = self.catalogue.references();
        // Nuisances are nearly linear within their tolerances; active numbers get columns of their
        // own.
        let about = Linearised::new(&observed, &references, &self.nuisances)?;
        let evidence: Vec<f64> = self
            .posed
            .iter()
            .map(|posed| {
                let fitted = fit(&observed, &about, &posed.own, &self.starts(posed))?;
                Some(fitted.evidence)
            })
            .collect::<Option<_>>()?;
        let rivals = (0..evidence.len()).filter(|rival| *rival != truth);
        let evidence = rivals.map(|rival| (rival, evidence[truth] - evidence[rival])).collect();
        Some(Rehearsal { truth, evidence })
    }

    /// Starts of the fit of a set: the known values, and each hypothesis' own starts.
    fn starts(&self, PosedHypothesis { own, from }: &PosedHypothesis) -> Vec<Vec<(usize, f64)>> {
        let mut starts = vec![from.clone(), Vec::new()];
        for hypothesis in own.iter().map(|h| &self.catalogue.hypotheses[*h]) {
            starts.extend(hypothesis.starts.iter().map(|start| {
                let mut values = from.clone();
                values.extend(start);
                values
            }));
        }
        starts
    }

    /// The manoeuvre as a vehicle with `effects` flies it under the daemon's feedback; `None` if it
    /// cannot be flown.
    fn fly(&self, manoeuvre: &Manoeuvre, effects: &EffectSet) -> Option<Flight> {
        let vehicle = self.proposal.vehicle;
        let sensors = self.proposal.noise.sensors();
        let simulator = FlightSimulator::new(&self.control, vehicle, effects, sensors).ok()?;
        let hover_thrust_n = self.control.vehicle().hover.hover_thrust_n();
        let course = ModelFreeReference::new(manoeuvre.trajectory.clone(), hover_thrust_n);
        let count = ((LEAD_S + course.duration()) / TICK_S) as usize;
        let ticks: Vec<(f64, Reference)> = (0..count)
            .map(|k| {
                let time = k as f64 * TICK_S;
                (time, course.sample(time - LEAD_S))
            })
            .collect();
        let start = ticks.first()?.1;
        let physics = Physics::new(vehicle, effects).ok()?;
        let collective = physics.hover_collective(&physics.calm())?;
        let departure = Departure {
            time: 0.0,
            state: State {
                position: start.position,
                attitude: Euler::new(0.0, 0.0, start.attitude.yaw).attitude(),
                ..State::default()
            },
            rotors: physics.rotors_for_wrench(&[collective, 0.0, 0.0, 0.0]),
        };
        simulator.fly(&departure, &ticks, None, self.proposal.seed).ok()
    }
}

impl PosedHypothesis {
    fn new(catalogue: &Catalogue, effects: &EffectSet) -> Self {
        let (mut own, mut from) = (Vec::new(), Vec::new());
        for (id, slots) in effects.iter() {
            let found = catalogue.hypotheses.iter().position(|hypothesis| {
                let is_of_rotor = |number: &usize| match catalogue.numbers[*number].target {
                    Target::RotorScale(rotor) => rotor as f64 == slots[0],
                    _ => true,
                };
                hypothesis.effect == id && hypothesis.numbers.iter().all(is_of_rotor)
            });
            let Some(index) = found else { continue };
            own.push(index);
            for number in &catalogue.hypotheses[index].numbers {
                let value = match catalogue.numbers[*number].target {
                    Target::Effect(_, slot) => slots[slot],
                    Target::RotorScale(_) => slots[1],
                    Target::OutputDelay if id == EffectId::CommandDelay => slots[0],
                    _ => continue,
                };
                from.push((*number, value));
            }
        }
        Self { own, from }
    }
}

/// Whether a simulated flight stays within its limits.
fn is_safe(flight: &Flight, manoeuvre: &Manoeuvre) -> bool {
    let stray = manoeuvre.demands.radius_m + STRAY_MAX_M;
    let steps = (manoeuvre.trajectory.duration() / 0.1) as usize;
    let heights = (0..=steps).map(|k| -manoeuvre.trajectory.sample(k as f64 * 0.1).position.down());
    let floor = HEIGHT_SHARE * heights.fold(f64::INFINITY, f64::min);
    let ceiling = manoeuvre.demands.height_m + STRAY_MAX_M;
    let is_inside = |p: &Ned| {
        let height = -p.down();
        p.north().hypot(p.east()) <= stray && height >= floor && height <= ceiling
    };
    let at_stop = |u: &&[f64; 4]| u.iter().any(|u| *u < OUTPUT_STOPS[0] || *u > OUTPUT_STOPS[1]);
    let saturated = flight.outputs.values().iter().filter(at_stop).count() as f64;
    flight.position.values().iter().all(is_inside)
        && flight.attitude.values().iter().all(|attitude| attitude.tilt() <= TILT_MAX_RAD)
        && saturated <= SATURATED_MAX * flight.outputs.len() as f64
}
