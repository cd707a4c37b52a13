//! What follows from the vehicle's identification: its feedback design, and the checks of its
//! parameters.

use super::attitude_loop::assumption;
use super::feedback::{Feedback, feedback};
use super::{End, Station};
use crate::clock::HostTime;
use crate::control::DesignError;
use crate::link::budget::{LINE_SHARE_MAX, LineBudget, state_bytes_per_s};
use crate::link::loss_reaction::{LossLaw, LossReaction};
use crate::link::profile::{Mode, Profile};
use crate::link::request::Request;
use crate::log::import::VehicleKind;
use crate::log::record::{Record, Severity};
use crate::offboard::{Airframe, LinkEvent, OffboardController};
use crate::parameters::Autopilot;
use crate::supervisor::{EngagePolicy, ModeMap, PreflightCheck};

/// The parameters that define the vehicle's motor outputs, for its log.
pub(super) fn log_parameters(profile: &Profile) -> Vec<String> {
    let autopilots =
        [(Profile::PX4.name, Autopilot::Px4), (Profile::ARDUCOPTER.name, Autopilot::ArduCopter)];
    let own = autopilots.into_iter().find(|(name, _)| *name == profile.name);
    own.map_or_else(Vec::new, |(_, autopilot)| autopilot.output_parameter_names())
}

impl Station {
    /// Designs the feedback for an identified vehicle.
    pub(super) fn identified(&mut self, now: HostTime, profile: Profile, is_version_known: bool) {
        let mask = profile.attitude_target.type_mask();
        let silent = if is_version_known { "" } else { ", which does not report its version" };
        let text =
            format!("vehicle is {}{silent}: setpoints with type mask {mask:#04x}", profile.name);
        self.report(now, Severity::Info, text.clone());
        self.is_version_known = is_version_known;
        let known = self.profile.replace(profile.clone());
        let is_known = self.offboard.is_some() && known.as_ref() == Some(&profile);
        if !is_known {
            self.replace_pilot(now);
        }
        // A commanded flight may be over before its cause is known.
        let is_commanded = self.settings.policy == EngagePolicy::Command;
        let is_over = self.end.is_some() || is_commanded && self.over_in.is_some();
        // The log of a flight that is over describes the vehicle that flew it.
        if !is_over {
            let facts = [
                ("autopilot".to_owned(), profile.name.to_owned()),
                ("attitude_target_mask".to_owned(), format!("{mask:#04x}")),
            ];
            self.records.push(Record::Facts(Box::new(facts.into())));
        }
        for rule in profile.required {
            self.session.request(now, Request::ReadParameter(rule.name.to_owned()));
        }
        for name in profile.loss.parameters() {
            self.session.request(now, Request::ReadParameter((*name).to_owned()));
        }
        for parameter in &self.settings.offboard.preflight.parameters {
            self.session.request(now, Request::ReadParameter(parameter.name.clone()));
        }
        if !is_known {
            for name in log_parameters(&profile) {
                self.session.request(now, Request::ReadParameter(name));
            }
        }
        // Each controller flies one commanded flight: another one would make the vehicle, which has
        // landed, take off again.
        if is_known || is_over {
            return;
        }
        let response = self.settings.control.attitude_response_rad_s;
        if let Some(assumed) = assumption(&profile, self.settings.attitude_pd, response) {
            self.report(now, Severity::Notice, assumed);
        }
        if let Some(why) = self.no_multirotor() {
            self.refuse(now, why);
            return;
        }
        match self.make_offboard(now, &profile) {
            Ok(Some(offboard)) => self.offboard = Some(offboard),
            Ok(None) => {
                let why = format!("the modes of autopilot {:?} are unknown", profile.name);
                self.refuse(now, why);
            }
            Err(error) => self.refuse(now, error.to_string()),
        }
        self.check_standing(now);
    }

    /// Why a vehicle is not flown that says of itself that it is no multirotor.
    fn no_multirotor(&self) -> Option<String> {
        let mav_type = self.session.vehicle()?.vehicle_type;
        let kind = VehicleKind::of_mav_type(mav_type)?;
        (kind != VehicleKind::Multirotor).then(|| {
            format!(
                "the vehicle is {kind} (MAV_TYPE {mav_type} in its HEARTBEAT); downwash flies only \
                 multirotors"
            )
        })
    }

    /// Refuses to fly the vehicle. That ends a commanded flight; under the pilot's switch another
    /// vehicle may still answer.
    fn refuse(&mut self, now: HostTime, why: String) {
        self.offboard = None;
        self.report(now, Severity::Error, why.clone());
        if self.settings.policy == EngagePolicy::Command {
            self.end.get_or_insert(End::Refused(why));
        }
    }

    /// Ends a flight or stream whose controller was designed for another vehicle.
    fn replace_pilot(&mut self, now: HostTime) {
        let Some(offboard) = &mut self.offboard else { return };
        let state = offboard.flight_state();
        if !state.precedes_stream() && !state.is_over() {
            offboard.link_event(now, LinkEvent::Replaced);
        }
        self.end_flight_of_another(now);
    }

    /// Ends the recording of a flight when another vehicle answers, before that vehicle's facts and
    /// controller appear in the log.
    pub(super) fn end_flight_of_another(&mut self, now: HostTime) {
        self.is_replaced = true;
        self.follow_pilot(now);
        self.end_aftermath();
    }

    fn make_offboard(
        &self,
        now: HostTime,
        profile: &Profile,
    ) -> Result<Option<OffboardController>, DesignError> {
        let custom_mode = |mode: Option<Mode>| mode.map(|mode| mode.custom_mode);
        let modes = (custom_mode(profile.modes.offboard), custom_mode(profile.modes.land));
        let (Some(offboard), Some(land)) = modes else { return Ok(None) };
        let Feedback { controller, reference } = feedback(profile, &self.settings)?;
        let airframe = Airframe {
            hover: self.settings.hover,
            thrust_full_n: self.settings.thrust_full_n,
            battery_full_v: self.settings.battery_full_v,
            modes: ModeMap {
                autopilot: profile.name,
                names: profile.mode_names,
                offboard,
                hold: custom_mode(profile.modes.hold),
                land,
                reports_intended: profile.reports_intended_mode,
            },
        };
        Ok(Some(OffboardController::new(
            self.settings.offboard.clone(),
            self.settings.policy,
            airframe,
            controller,
            Box::new(reference),
            Vec::new(),
            now,
        )))
    }

    /// Updates the standing preflight checks: parameters that break a rule of the profile, signing,
    /// the capacity of a serial line, a second autopilot, the reaction to the loss of this program.
    pub(super) fn check_standing(&mut self, now: HostTime) {
        let (Some(profile), Some(offboard)) = (&self.profile, &mut self.offboard) else { return };
        let known = &offboard.telemetry().status().parameters;
        let reaction = profile.loss.reaction(known, self.settings.session.system);
        let mut failed: Vec<PreflightCheck> = profile
            .required
            .iter()
            .filter_map(|rule| {
                let found = known.get(rule.name);
                (!found.is_some_and(|value| rule.holds(*value))).then(|| PreflightCheck {
                    subject: format!("parameter {}", rule.name),
                    expected: format!("{}, because {}", rule.rule, rule.why),
                    found: found.map_or("no answer".to_owned(), f64::to_string),
                })
            })
            .collect();
        // A vehicle that answers accepts unsigned frames, so anything still missing has another
        // cause.
        let is_deaf = !self.is_version_known && !self.is_answered;
        if self.session.is_signed() && !self.session.signs() && is_deaf {
            failed.push(PreflightCheck {
                subject: "signing".to_owned(),
                expected: "none on this link, or its key in link.signing".to_owned(),
                found: "signed messages, and no answer to unsigned ones".to_owned(),
            });
        }
        let preflight = &self.settings.offboard.preflight;
        let needed_hz = preflight.tick_rate_min * self.settings.offboard.telemetry.rate_hz;
        failed.extend(self.session.budget().and_then(|budget| line_check(budget, needed_hz)));
        if let Some(other) = self.session.others().first() {
            failed.push(PreflightCheck {
                subject: "vehicles".to_owned(),
                expected: "one autopilot, or --system".to_owned(),
                found: format!("another: {other}"),
            });
        }
        if self.settings.offboard.preflight.needs_loss_reaction {
            failed.extend(loss_check(profile.loss, &reaction));
        }
        offboard.set_standing_checks(failed);
        let text = match &reaction {
            LossReaction::Acts(text) => format!("if this program vanishes: {text}"),
            LossReaction::Nothing { why, .. } => {
                format!("if this program vanishes, the vehicle does not react: {why}")
            }
            LossReaction::Unread(_) => return,
        };
        // Parameters arrive one by one: an event reports the reaction each time it changes.
        if self.reported_loss.as_ref() != Some(&text) {
            self.reported_loss = Some(text.clone());
            self.report(now, Severity::Info, text);
        }
    }
}

/// The preflight check that a serial line has room for the state at `needed_hz`.
fn line_check(budget: &LineBudget, needed_hz: f64) -> Option<PreflightCheck> {
    let state_hz = budget.state_hz();
    if state_hz >= needed_hz && budget.fits() {
        return None;
    }
    let (baud, carried, share) = (budget.baud, budget.bytes_per_s(), 100.0 * LINE_SHARE_MAX);
    let cure = if budget.fits() {
        format!("set control.rate_hz to {state_hz:.0} or less, or raise the baud rate")
    } else {
        "raise the baud rate".to_owned()
    };
    Some(PreflightCheck {
        subject: "serial line".to_owned(),
        expected: format!(
            "room for {needed_hz:.0} Hz of attitude and position, {:.0} bytes/s; {cure}",
            state_bytes_per_s(needed_hz)
        ),
        found: format!(
            "{baud} baud, which carries {carried:.0} bytes/s, {share:.0} % of them for telemetry: \
             room for {state_hz:.0} Hz"
        ),
    })
}

/// The preflight check that the vehicle reacts when this program vanishes. PX4 reacts whatever its
/// parameters are.
fn loss_check(law: LossLaw, reaction: &LossReaction) -> Option<PreflightCheck> {
    let (cure, found) = match reaction {
        LossReaction::Nothing { why, cure } => (cure.clone(), why.clone()),
        LossReaction::Unread(name) if law == LossLaw::ArduCopter => {
            (format!("the parameter {name} sets it"), "no answer".to_owned())
        }
        LossReaction::Acts(_) | LossReaction::Unread(_) => return None,
    };
    Some(PreflightCheck {
        subject: "reaction of the vehicle when this program vanishes".to_owned(),
        expected: format!(
            "one; {cure}, or set offboard.preflight.needs_loss_reaction = false to fly without one"
        ),
        found,
    })
}
