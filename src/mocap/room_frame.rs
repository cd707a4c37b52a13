//! From a room's axes to north, east, down, and from a body's to front, right, down.
//!
//! A room is right-handed, with z or y up. Its x axis has the heading psi, clockwise from north
//! seen from above:
//!
//! - z up: north, east, down of x, y, z are (cos psi, sin psi, 0), (sin psi, -cos psi, 0), (0, 0,
//!   -1);
//! - y up: those of x, y, z are (cos psi, sin psi, 0), (0, 0, -1), (-sin psi, cos psi, 0).
//!
//! A tracker gives a body the room's axes at the moment of its definition. If the nose points along
//! the body's x axis, the body's own axes relate to front, right, down as the room's axes relate to
//! north, east, down with psi 0. A nose that points elsewhere adds a rotation by its heading from
//! that axis.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use vehicle::frame::{Attitude, Frd, Ned};

/// The axis of the room that points up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, JsonSchema, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Up {
    /// z, as in Vicon, Qualisys and ROS.
    #[default]
    Z,
    /// y, the default of Motive.
    Y,
}

/// A room's axes relative to north, east, down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RoomFrame {
    /// From the room's axes to north, east, down.
    world: Attitude,
    /// From front, right, down to the body's axes.
    body: Attitude,
}

impl RoomFrame {
    /// A room whose x axis has the heading `x_heading`, and a body whose nose points `nose` from
    /// its x axis, both clockwise seen from above, rad.
    pub fn new(up: Up, x_heading: f64, nose: f64) -> Self {
        let upright = match up {
            // Half a turn about x.
            Up::Z => Attitude { w: 0.0, x: 1.0, y: 0.0, z: 0.0 },
            // A quarter of a turn about x, which takes y up.
            Up::Y => {
                let half = std::f64::consts::FRAC_1_SQRT_2;
                Attitude { w: half, x: -half, y: 0.0, z: 0.0 }
            }
        };
        Self {
            world: about_down(x_heading).compose(upright),
            body: upright.inverse().compose(about_down(nose)),
        }
    }

    /// A position from room axes to north, east, down, m.
    pub fn position(&self, in_room: [f64; 3]) -> Ned {
        let [x, y, z] = in_room;
        // A plain rotation of a vector, whatever the names of its axes.
        self.world.to_world(Frd::new(x, y, z))
    }

    /// The attitude of a body from its rotation to the room's axes, a unit quaternion w, x, y, z.
    pub fn attitude(&self, [w, x, y, z]: [f64; 4]) -> Attitude {
        self.world.compose(Attitude { w, x, y, z }).compose(self.body).normalized()
    }
}

fn about_down(angle: f64) -> Attitude {
    let (z, w) = (0.5 * angle).sin_cos();
    Attitude { w, x: 0.0, y: 0.0, z }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{FRAC_1_SQRT_2, FRAC_PI_2, PI};

    use proptest::prelude::*;

    use super::*;

    const NONE: [f64; 4] = [1.0, 0.0, 0.0, 0.0];

    fn is_near(a: Ned, b: [f64; 3]) -> bool {
        (a - Ned::from(b)).norm() < 1e-12
    }

    #[test]
    fn z_up_room_is_half_a_turn_about_x() {
        let room = RoomFrame::new(Up::Z, 0.0, 0.0);
        assert!(is_near(room.position([1.0, 2.0, 3.0]), [1.0, -2.0, -3.0]));
        assert!(room.attitude(NONE).angle_to(Attitude::default()) < 1e-9);
        // About z by +90 degrees is to the left: the heading is west.
        let left = room.attitude([FRAC_1_SQRT_2, 0.0, 0.0, FRAC_1_SQRT_2]);
        assert!((left.yaw() + FRAC_PI_2).abs() < 1e-9);
        // About x by +0.3 rad lowers the right side in both.
        let (sin, cos) = 0.15f64.sin_cos();
        assert!((room.attitude([cos, sin, 0.0, 0.0]).euler().roll - 0.3).abs() < 1e-9);
        // About y by +0.3 rad puts the nose down.
        assert!((room.attitude([cos, 0.0, sin, 0.0]).euler().pitch + 0.3).abs() < 1e-9);
    }

    #[test]
    fn y_up_room_has_east_along_z() {
        let room = RoomFrame::new(Up::Y, 0.0, 0.0);
        assert!(is_near(room.position([1.0, 2.0, 3.0]), [1.0, 3.0, -2.0]));
        assert!(room.attitude(NONE).angle_to(Attitude::default()) < 1e-9);
        let left = room.attitude([FRAC_1_SQRT_2, 0.0, FRAC_1_SQRT_2, 0.0]);
        assert!((left.yaw() + FRAC_PI_2).abs() < 1e-9);
        let (sin, cos) = 0.15f64.sin_cos();
        assert!((room.attitude([cos, sin, 0.0, 0.0]).euler().roll - 0.3).abs() < 1e-9);
        assert!((room.attitude([cos, 0.0, 0.0, sin]).euler().pitch - 0.3).abs() < 1e-9);
    }

    #[test]
    fn heading_rotates_the_room_and_nose_the_vehicle() {
        for up in [Up::Z, Up::Y] {
            let room = RoomFrame::new(up, FRAC_PI_2, 0.0);
            assert!(is_near(room.position([1.0, 0.0, 0.0]), [0.0, 1.0, 0.0]), "x points east");
            assert!((room.attitude(NONE).yaw() - FRAC_PI_2).abs() < 1e-9);
            let room = RoomFrame::new(up, 0.0, FRAC_PI_2);
            assert!(is_near(room.position([1.0, 0.0, 0.0]), [1.0, 0.0, 0.0]));
            assert!((room.attitude(NONE).yaw() - FRAC_PI_2).abs() < 1e-9, "its nose points east");
            let room = RoomFrame::new(up, PI, 0.0);
            assert!(is_near(room.position([1.0, 0.0, 0.0]), [-1.0, 0.0, 0.0]));
        }
    }

    fn unit() -> impl Strategy<Value = [f64; 4]> {
        prop::array::uniform4(-1.0..1.0f64).prop_filter_map("too short", |q| {
            let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
            (norm > 0.1).then(|| q.map(|c| c / norm))
        })
    }

    proptest! {
        /// A point fixed to the body has one place, whether it is computed through the room, with
        /// vectors and matrices as the module's docs define them, or through the attitude.
        #[test]
        fn body_point_maps_consistently_through_frame_and_attitude(
            q in unit(), p in prop::array::uniform3(-5.0..5.0f64),
            point in prop::array::uniform3(-1.0..1.0f64), psi in -PI..PI, nose in -PI..PI,
            is_y in any::<bool>(),
        ) {
            let up = if is_y { Up::Y } else { Up::Z };
            let axes = |heading: f64| {
                let (s, c) = heading.sin_cos();
                match up {
                    Up::Z => [[c, s, 0.0], [s, -c, 0.0], [0.0, 0.0, -1.0]],
                    Up::Y => [[c, s, 0.0], [0.0, 0.0, -1.0], [-s, c, 0.0]],
                }
            };
            let along = |axes: [[f64; 3]; 3], v: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|row| (0..3).map(|k| axes[k][row] * v[k]).sum())
            };
            // The vehicle's front is the nose's direction in the body's axes.
            let [front, right, down] = point;
            let (s, c) = nose.sin_cos();
            let level = [front * c - right * s, front * s + right * c, down];
            let of_body = axes(0.0);
            let in_body: [f64; 3] =
                std::array::from_fn(|k| (0..3).map(|row| of_body[k][row] * level[row]).sum());
            let turned = Attitude { w: q[0], x: q[1], y: q[2], z: q[3] }.to_world(Frd::from(in_body));
            let [x, y, z] = turned.to_array();
            let expected = along(axes(psi), [p[0] + x, p[1] + y, p[2] + z]);

            let room = RoomFrame::new(up, psi, nose);
            let found = room.position(p) + room.attitude(q).to_world(Frd::from(point));
            prop_assert!((found - Ned::from(expected)).norm() < 1e-9, "{found:?} {expected:?}");
        }
    }
}
