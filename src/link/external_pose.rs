//! An externally measured pose, as a message to the vehicle.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Attitude, Euler, Ned};
use wire::dialect::{
    MavEstimatorType, MavFrame, MavMessage, ODOMETRY_DATA, VISION_POSITION_ESTIMATE_DATA,
};

use crate::clock::VehicleTime;

/// What the pose is sent as.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize, clap::ValueEnum,
)]
#[serde(rename_all = "kebab-case")]
pub enum PoseForm {
    /// VISION_POSITION_ESTIMATE: position and Euler angles in north, east, down.
    #[default]
    Vision,
    /// ODOMETRY in MAV_FRAME_LOCAL_FRD and MAV_FRAME_BODY_FRD, without a velocity.
    Odometry,
}

/// A vehicle's pose from a measurement outside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExternalPose {
    /// Vehicle time of the measurement.
    pub time: VehicleTime,
    /// Position in the vehicle's local frame, m.
    pub position: Ned,
    /// Attitude.
    pub attitude: Attitude,
    /// Standard deviation of the position, per axis, m.
    pub position_deviation_m: f64,
    /// Standard deviation of the attitude, about each axis, rad.
    pub attitude_deviation_rad: f64,
    /// Number of restarts of the pose stream, modulo 256.
    pub reset_count: u8,
}

impl ExternalPose {
    /// The MAVLink message for the pose.
    pub fn message(&self, form: PoseForm) -> MavMessage {
        let [x, y, z] = self.position.to_array().map(|value| value as f32);
        let covariance = self.covariance();
        match form {
            PoseForm::Vision => {
                let Euler { roll, pitch, yaw } = self.attitude.euler();
                MavMessage::VISION_POSITION_ESTIMATE(VISION_POSITION_ESTIMATE_DATA {
                    usec: self.time.as_us(),
                    x,
                    y,
                    z,
                    roll: roll as f32,
                    pitch: pitch as f32,
                    yaw: yaw as f32,
                    covariance,
                    reset_counter: self.reset_count,
                })
            }
            PoseForm::Odometry => {
                // NaN marks a value that is not measured; in a covariance, its first element does.
                let mut unknown = [0.0; 21];
                unknown[0] = f32::NAN;
                MavMessage::ODOMETRY(ODOMETRY_DATA {
                    time_usec: self.time.as_us(),
                    x,
                    y,
                    z,
                    q: self.attitude.to_wire(),
                    vx: f32::NAN,
                    vy: f32::NAN,
                    vz: f32::NAN,
                    rollspeed: f32::NAN,
                    pitchspeed: f32::NAN,
                    yawspeed: f32::NAN,
                    pose_covariance: covariance,
                    velocity_covariance: unknown,
                    frame_id: MavFrame::MAV_FRAME_LOCAL_FRD,
                    child_frame_id: MavFrame::MAV_FRAME_BODY_FRD,
                    reset_counter: self.reset_count,
                    estimator_type: MavEstimatorType::MAV_ESTIMATOR_TYPE_VISION,
                    quality: 100,
                })
            }
        }
    }

    /// The upper triangle of the 6 x 6 covariance of position and attitude, row by row.
    fn covariance(&self) -> [f32; 21] {
        let mut upper = [0.0; 21];
        let (place, turn) =
            (self.position_deviation_m.powi(2), self.attitude_deviation_rad.powi(2));
        for (at, variance) in
            [(0, place), (6, place), (11, place), (15, turn), (18, turn), (20, turn)]
        {
            upper[at] = variance as f32;
        }
        upper
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POSE: ExternalPose = ExternalPose {
        time: VehicleTime::from_us(1_234_567),
        position: Ned::new(1.0, -2.0, -0.5),
        attitude: Attitude { w: 0.8, x: 0.0, y: 0.0, z: 0.6 },
        position_deviation_m: 0.01,
        attitude_deviation_rad: 0.1,
        reset_count: 3,
    };

    #[test]
    fn both_pose_messages_carry_the_same_pose() {
        let MavMessage::VISION_POSITION_ESTIMATE(vision) = POSE.message(PoseForm::Vision) else {
            panic!()
        };
        let MavMessage::ODOMETRY(odometry) = POSE.message(PoseForm::Odometry) else { panic!() };
        assert_eq!((vision.usec, odometry.time_usec), (1_234_567, 1_234_567));
        assert_eq!((vision.x, vision.y, vision.z), (1.0, -2.0, -0.5));
        assert_eq!((odometry.x, odometry.y, odometry.z), (1.0, -2.0, -0.5));
        assert!((f64::from(vision.yaw) - 2.0 * 0.6f64.asin()).abs() < 1e-6);
        assert_eq!(odometry.q, [0.8, 0.0, 0.0, 0.6]);
        assert_eq!((vision.reset_counter, odometry.reset_counter), (3, 3));
        assert_eq!(vision.covariance, odometry.pose_covariance);
        // xx, yy, zz, roll, pitch, yaw of an upper triangle of rows 6, 5, 4, 3, 2, 1.
        let diagonal = [0, 6, 11, 15, 18, 20].map(|at| vision.covariance[at]);
        assert_eq!(diagonal, [1e-4, 1e-4, 1e-4, 1e-2, 1e-2, 1e-2]);
        assert!(odometry.vx.is_nan() && odometry.velocity_covariance[0].is_nan());
    }
}
