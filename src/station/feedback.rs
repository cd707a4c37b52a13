//! Feedback and reference for a vehicle with a known autopilot.

use std::sync::Arc;

use super::StationSettings;
use super::attitude_loop::{assumption, attitude_loop};
use crate::control::{
    Adaptation, AttitudeError, ControlProblem, Controller, DesignError, DisturbanceObserver,
};
use crate::link::profile::Profile;
use crate::plan::reference::{FeedForward, ReferenceSource};

/// Feedback and reference for one autopilot.
pub(super) struct Feedback {
    pub controller: Controller,
    pub reference: Arc<dyn ReferenceSource + Send + Sync>,
}

/// Designs the feedback around the attitude loop of `profile`'s autopilot.
///
/// The bundled vehicle uses the paper's loop, and by default the paper's feedback. Any other
/// autopilot has its own loop, and the observer and feed-forward keep the unknown part of it from
/// leaving a steady error.
pub(super) fn feedback(
    profile: &Profile,
    settings: &StationSettings,
) -> Result<Feedback, DesignError> {
    let StationSettings { actuation, hover, control, attitude_pd, offboard, .. } = settings;
    let is_own_loop = profile.name != Profile::BUNDLED.name;
    let error =
        if profile.compares_angles { AttitudeError::Angles } else { AttitudeError::Rotation };
    // The lag of an assumed loop would make the attitude lead too much.
    let is_known = assumption(profile, *attitude_pd, control.attitude_response_rad_s).is_none();
    let attitude_loop = attitude_loop(profile, *attitude_pd, control.attitude_response_rad_s);
    let controller = Controller::design(&ControlProblem {
        vehicle: hover,
        actuation,
        attitude_loop: &attitude_loop,
        limits: &offboard.limits,
        settings: control,
    })?;
    let observes = offboard.offset_free.observer.applies(is_own_loop);
    let observer = (observes || control.adaptive).then(|| {
        let observer = DisturbanceObserver::new(
            offboard.offset_free,
            *hover,
            attitude_loop,
            error,
            *actuation,
        );
        if control.adaptive {
            observer.adapting(Adaptation::new(control.adaptation), observes)
        } else {
            observer
        }
    });
    let feed_forward =
        offboard.offset_free.feed_forward.applies(is_own_loop).then(|| FeedForward {
            mass_kg: hover.mass_kg,
            gravity: hover.gravity,
            drag_kg_s: settings.drag_kg_s,
            tilt_max_rad: offboard.limits.tilt_max_rad,
            attitude_delay_s: actuation.attitude_delay_s(&attitude_loop),
            thrust_delay_s: actuation.thrust_delay_s(),
        });
    let fed_forward = feed_forward.and_then(|with| settings.reference.with_feed_forward(&with));
    Ok(Feedback {
        controller: controller.addressing(error, is_known).observing(observer),
        reference: fed_forward.unwrap_or_else(|| Arc::clone(&settings.reference)),
    })
}
