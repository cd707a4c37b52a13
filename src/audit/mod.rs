//! Audits logs before any physics: faults of the data and of the measurement.
//!
//! No check uses a vehicle model. Late or rotated streams, biased sensors, gaps, frozen or
//! impossible values and files of the same flight are reported as such, and must not be passed on
//! as effects of the vehicle.

mod agreement;
mod alignment;
mod axes;
mod contrast;
mod conventions;
mod duplicates;
mod finding;
mod frames;
mod initial_fit;
mod kinematics;
mod motors;
mod output_order;
mod pair;
mod rates;
mod rotors;
mod tier;
mod timing;
mod values;
mod vehicle;
mod weak;

use schemars::JsonSchema;
use serde::Serialize;

use self::output_order::OutputMoments;
use self::rotors::Responses;
use crate::learn::segments::Cut;
use crate::log::import::{Flight, RotorFact};
pub use agreement::{Agreement, Estimate};
pub use alignment::{Shift, align};
pub use finding::{Finding, Severity};
pub use kinematics::Kinematics;
pub use rates::Rates;
pub use rotors::RotorEffects;
pub use tier::{Channels, FAST_HZ, Tier};
pub use timing::{LEFT_OUT, NO_SAMPLES, StreamTiming};
pub(crate) use weak::median;

/// A time in which a stream must not be used.
#[derive(Clone, Debug, PartialEq, JsonSchema, Serialize)]
pub struct UnusableSpan {
    /// Name of the stream.
    pub stream: &'static str,
    /// Start, s of the vehicle's clock.
    pub from_s: f64,
    /// End, s of the vehicle's clock.
    pub to_s: f64,
    /// Why it must not be used.
    pub reason: &'static str,
}

/// The audit of a log.
#[derive(Clone, Debug, JsonSchema, Serialize)]
pub struct Audit {
    /// Path of the file.
    pub file: String,
    /// Name of the flight.
    pub run: String,
    /// `mcap`, `tlog`, `ulog`, `dataflash` or `csv`.
    pub format: &'static str,
    /// SHA-256 of the file.
    pub sha256: String,
    /// Logged channels, as far as they decide what can be tested.
    pub channels: Channels,
    /// The most that the channels can show; `None` without a pose.
    pub tier: Option<Tier>,
    /// Rates, gaps and jitter of each stream.
    pub streams: Vec<StreamTiming>,
    /// Rates of new values, whatever the logged rates.
    pub rates: Rates,
    /// Relative rate by which the ground's clock was faster than the vehicle's.
    pub ground_skew: Option<f64>,
    /// Agreement between the streams.
    pub kinematics: Kinematics,
    /// Effect of each motor output on the body, where the motion shows it.
    pub rotors: Option<RotorEffects>,
    /// The rotation and the outputs before it.
    #[serde(skip)]
    responses: Option<OutputMoments>,
    /// Findings, worst first.
    pub findings: Vec<Finding>,
    /// Times in which streams must not be used, in order.
    pub unusable: Vec<UnusableSpan>,
}

impl Audit {
    /// Audits one flight.
    pub fn of(flight: &Flight) -> Self {
        let mut audit = Self::of_one(flight);
        check_stated_order(std::slice::from_ref(flight), std::slice::from_mut(&mut audit));
        audit
    }

    /// Audits one flight, except for the order of its outputs.
    fn of_one(flight: &Flight) -> Self {
        let responses = Responses::of(flight);
        let fresh = flight.without_repeats();
        let kinematics = Kinematics::of(&fresh);
        let channels = Channels::of(flight);
        let mut audit = Self {
            file: flight.origin.path.display().to_string(),
            run: flight.origin.run.clone(),
            format: flight.origin.format,
            sha256: flight.origin.sha256.clone(),
            channels,
            tier: Tier::of(&channels),
            streams: timing::streams(flight),
            rates: Rates::of(flight),
            ground_skew: flight.ground_skew,
            kinematics,
            rotors: responses.as_ref().and_then(RotorEffects::of),
            responses: responses.as_ref().map(OutputMoments::of),
            findings: Vec::new(),
            unusable: Vec::new(),
        };
        timing::check(flight, &mut audit);
        values::check(flight, &fresh, &mut audit);
        vehicle::check(flight, &mut audit);
        motors::check(flight, &mut audit);
        conventions::check(&fresh, &mut audit);
        audit.sort();
        audit
    }

    /// Audits several flights. Of files of the same flight, the later one is at fault.
    pub fn of_all(flights: &[Flight]) -> Vec<Self> {
        use rayon::prelude::*;
        let mut audits: Vec<Self> = flights.par_iter().map(Self::of_one).collect();
        check_stated_order(flights, &mut audits);
        duplicates::check(flights, &mut audits);
        audits.iter_mut().for_each(Self::sort);
        audits
    }

    /// Whether the data are at fault: the log supports no conclusion until they are repaired.
    pub fn is_faulty(&self) -> bool {
        self.findings.iter().any(|finding| finding.severity == Severity::Fault)
    }

    /// The times to exclude from use, except gaps, which the readers of the streams handle.
    pub fn cuts(&self) -> Vec<Cut> {
        let spans = self.unusable.iter().filter(|span| span.reason != NO_SAMPLES);
        let cut = |span: &UnusableSpan| Cut {
            stream: span.stream,
            reason: span.reason,
            times: span.from_s..span.to_s,
        };
        spans.map(cut).collect()
    }

    /// The first fault in the data that the importer kept.
    pub fn fault_of_data(&self) -> Option<&Finding> {
        self.faults().find(|fault| fault.check != LEFT_OUT)
    }

    /// Faults that exclude the whole log, rather than some times of it.
    pub fn faults(&self) -> impl Iterator<Item = &Finding> {
        let faults = self.findings.iter().filter(|f| f.severity == Severity::Fault);
        faults.filter(|finding| finding.check != values::STOOD_STILL)
    }

    fn sort(&mut self) {
        self.findings.sort_by_key(|finding| std::cmp::Reverse(finding.severity));
        self.unusable.sort_by(|a, b| a.from_s.total_cmp(&b.from_s));
    }
}

/// Adds a fault to flights of one vehicle if their outputs contradict its rotors. `whose` says where
/// the rotors are known from. Logs with another fault decide nothing, but share the answer.
pub(crate) fn check_order(audits: &mut [&mut Audit], rotors: &[RotorFact; 4], whose: &str) {
    let is_known =
        |audit: &Audit| audit.findings.iter().any(|f| f.check == output_order::MOTOR_ORDER);
    let sound = audits.iter().filter(|audit| !audit.is_faulty());
    let responses: Vec<&OutputMoments> =
        sound.filter_map(|audit| audit.responses.as_ref()).collect();
    let Some(fault) = output_order::fault(&responses, rotors, whose) else { return };
    for audit in audits.iter_mut().filter(|audit| audit.responses.is_some() && !is_known(audit)) {
        audit.findings.push(fault.clone());
        audit.sort();
    }
}

/// Compares outputs with the rotors that the autopilots' parameters state.
fn check_stated_order(flights: &[Flight], audits: &mut [Audit]) {
    let mut vehicles: Vec<&[RotorFact]> = Vec::new();
    for flight in flights {
        let rotors = flight.facts.rotors.as_slice();
        let Ok(stated) = <&[RotorFact; 4]>::try_from(rotors) else { continue };
        if vehicles.contains(&rotors) {
            continue;
        }
        vehicles.push(rotors);
        let of_vehicle = flights.iter().zip(audits.iter_mut());
        let mut of_vehicle: Vec<&mut Audit> = of_vehicle
            .filter(|(flight, _)| flight.facts.rotors == rotors)
            .map(|(_, audit)| audit)
            .collect();
        check_order(&mut of_vehicle, stated, "the autopilot's motors");
    }
}
