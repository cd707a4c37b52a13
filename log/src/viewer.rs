//! Well-known foxglove messages for 3D views. Only this module uses a viewer's frames: world ENU
//! (`map`), body FLU (`base_link`).

use foxglove::messages::{
    Color, CubePrimitive, CylinderPrimitive, FrameTransform, LinePrimitive, Log, Point3, Pose,
    PoseInFrame, Quaternion, SceneEntity, SceneUpdate, Timestamp, Vector3, line_primitive, log,
};
use message::clock::HostTime;
use vehicle::frame::{Attitude, Frd, Ned};

use super::record::{Severity, Source};

/// The viewer's world frame: east, north, up, with the origin of the vehicle's local frame.
pub(super) const MAP: &str = "map";
/// The vehicle's body frame: front, left, up.
pub(super) const BASE_LINK: &str = "base_link";
/// The reference's body frame: front, left, up.
pub(super) const BASE_LINK_REF: &str = "base_link_ref";

/// A body's pose in the viewer's frames.
pub(super) struct ViewerPose {
    position: Vector3,
    orientation: Quaternion,
}

impl ViewerPose {
    /// The pose of a body at `position` with `attitude`.
    pub(super) fn new(position: Ned, attitude: Attitude) -> Self {
        Self { position: enu(position), orientation: enu_flu(attitude) }
    }

    /// Writes the pose to `message` as a transform from parent to child.
    pub(super) fn to_transform(&self, time: HostTime, message: &mut FrameTransform) {
        message.timestamp = Some(timestamp(time));
        message.translation = Some(self.position);
        message.rotation = Some(self.orientation);
    }

    /// Writes the pose in [`MAP`] to `message`.
    pub(super) fn to_pose(&self, time: HostTime, message: &mut PoseInFrame) {
        message.timestamp = Some(timestamp(time));
        message.pose =
            Some(Pose { position: Some(self.position), orientation: Some(self.orientation) });
    }
}

/// NED to ENU: (x, y, z) -> (y, x, -z).
fn enu(v: Ned) -> Vector3 {
    Vector3 { x: v.east(), y: v.north(), z: -v.down() }
}

/// FRD to FLU: (x, y, z) -> (x, -y, -z).
fn flu(v: Frd) -> Vector3 {
    Vector3 { x: v.front(), y: -v.right(), z: -v.down() }
}

/// `q_enu_flu = (0, sqrt(1/2), sqrt(1/2), 0) * q_ned_frd * (0, 1, 0, 0)` in w, x, y, z: from FLU to
/// FRD, then to NED, then to ENU; w >= 0.
fn enu_flu(attitude: Attitude) -> Quaternion {
    use std::f64::consts::FRAC_1_SQRT_2;
    let enu_from_ned = Attitude { w: 0.0, x: FRAC_1_SQRT_2, y: FRAC_1_SQRT_2, z: 0.0 };
    let frd_from_flu = Attitude { w: 0.0, x: 1.0, y: 0.0, z: 0.0 };
    let q = enu_from_ned.compose(attitude).compose(frd_from_flu).canonical();
    Quaternion { x: q.x, y: q.y, z: q.z, w: q.w }
}

fn timestamp(time: HostTime) -> Timestamp {
    let seconds = u32::try_from(time.as_ns() / 1_000_000_000).unwrap_or(u32::MAX);
    Timestamp::new(seconds, (time.as_ns() % 1_000_000_000) as u32)
}

/// A line for `/log`.
pub(super) fn log_message(time: HostTime, severity: Severity, source: Source, text: &str) -> Log {
    let level = match severity {
        Severity::Emergency | Severity::Alert | Severity::Critical => log::Level::Fatal,
        Severity::Error => log::Level::Error,
        Severity::Warning => log::Level::Warning,
        Severity::Notice | Severity::Info => log::Level::Info,
        Severity::Debug => log::Level::Debug,
    };
    Log {
        timestamp: Some(timestamp(time)),
        level: level as i32,
        message: text.to_owned(),
        name: source.name().to_owned(),
        ..Default::default()
    }
}

/// The vehicle and a translucent reference, each with a body, a nose and a disc for each rotor.
///
/// `rotors` are their positions in body axes, m.
pub(super) fn scene(time: HostTime, rotors: &[Frd]) -> SceneUpdate {
    let reach = rotors.iter().map(|r| r.norm()).fold(0.0, f64::max).max(0.02);
    let entity = |frame: &str, alpha: f64| {
        let at = |position: Vector3| Pose {
            position: Some(position),
            orientation: Some(Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 1.0 }),
        };
        let body = CubePrimitive {
            pose: Some(at(Vector3 { x: 0.0, y: 0.0, z: 0.0 })),
            size: Some(Vector3 { x: 0.7 * reach, y: 0.4 * reach, z: 0.2 * reach }),
            color: Some(Color { r: 0.25, g: 0.27, b: 0.30, a: alpha }),
        };
        let nose = CubePrimitive {
            pose: Some(at(Vector3 { x: 0.45 * reach, y: 0.0, z: 0.0 })),
            size: Some(Vector3 { x: 0.3 * reach, y: 0.1 * reach, z: 0.1 * reach }),
            color: Some(Color { r: 0.90, g: 0.40, b: 0.10, a: alpha }),
        };
        let disc = |rotor: &Frd| CylinderPrimitive {
            pose: Some(at(flu(*rotor))),
            size: Some(Vector3 { x: 0.9 * reach, y: 0.9 * reach, z: 0.05 * reach }),
            bottom_scale: 1.0,
            top_scale: 1.0,
            color: Some(Color { r: 0.12, g: 0.47, b: 0.71, a: 0.7 * alpha }),
        };
        SceneEntity {
            timestamp: Some(timestamp(time)),
            frame_id: frame.to_owned(),
            id: frame.to_owned(),
            frame_locked: true,
            cubes: vec![body, nose],
            cylinders: rotors.iter().map(disc).collect(),
            ..Default::default()
        }
    };
    SceneUpdate {
        entities: vec![entity(BASE_LINK, 1.0), entity(BASE_LINK_REF, 0.3)],
        ..Default::default()
    }
}

/// A line through `points`, `width` pixels wide; it replaces an earlier line with the same `id`.
pub fn line(
    time: HostTime,
    id: &str,
    colour: [f64; 4],
    width: f64,
    points: impl Iterator<Item = Ned>,
) -> SceneUpdate {
    let [r, g, b, a] = colour;
    let point = |ned| {
        let Vector3 { x, y, z } = enu(ned);
        Point3 { x, y, z }
    };
    let line = LinePrimitive {
        r#type: line_primitive::Type::LineStrip as i32,
        thickness: width,
        scale_invariant: true,
        points: points.map(point).collect(),
        color: Some(Color { r, g, b, a }),
        ..Default::default()
    };
    let entity = SceneEntity {
        timestamp: Some(timestamp(time)),
        frame_id: MAP.to_owned(),
        id: id.to_owned(),
        lines: vec![line],
        ..Default::default()
    };
    SceneUpdate { entities: vec![entity], ..Default::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_1_SQRT_2;

    #[test]
    fn level_facing_north_is_90_degrees_left_of_east() {
        let q = enu_flu(Attitude::default());
        assert!((q.w - FRAC_1_SQRT_2).abs() < 1e-12 && (q.z.abs() - FRAC_1_SQRT_2).abs() < 1e-12);
        assert!(q.z > 0.0 && q.x.abs() < 1e-12 && q.y.abs() < 1e-12);
    }

    #[test]
    fn rotation_commutes_with_frame_conversion() {
        let attitude = vehicle::frame::Euler::new(0.3, -0.4, 1.2).attitude();
        let body = Frd::new(1.0, 2.0, 3.0);
        let expected = enu(attitude.to_world(body));
        let q = enu_flu(attitude);
        let viewer = Attitude { w: q.w, x: q.x, y: q.y, z: q.z };
        let Vector3 { x, y, z } = flu(body);
        let found = viewer.to_world(Frd::new(x, y, z)).to_array();
        for (found, expected) in found.iter().zip([expected.x, expected.y, expected.z]) {
            assert!((found - expected).abs() < 1e-12);
        }
    }
}
