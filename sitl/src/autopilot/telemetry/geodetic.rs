//! Messages with the vehicle's geodetic position.

use wire::dialect::*;

use super::{Snapshot, floats};
use crate::config::Home;
use vehicle::ROTORS;
use vehicle::frame::Ned;

/// Radius of the earth for the local tangent plane, m (PX4's).
const EARTH_RADIUS_M: f64 = 6_371_000.0;

/// Latitude and longitude in 1e-7 degrees and altitude in mm of the point at `offset` from
/// `origin`, on the tangent plane.
pub(super) fn geodetic(origin: &Home, offset: Ned) -> [i32; 3] {
    let north = (offset.north() / EARTH_RADIUS_M).to_degrees();
    let parallel = EARTH_RADIUS_M * origin.latitude_deg.to_radians().cos();
    let east = (offset.east() / parallel).to_degrees();
    let altitude_m = origin.altitude_m - offset.down();
    let wire = [
        (origin.latitude_deg + north) * 1e7,
        (origin.longitude_deg + east) * 1e7,
        altitude_m * 1e3,
    ];
    wire.map(|value| value.round() as i32)
}

impl Snapshot<'_> {
    pub(super) fn global_position(&self) -> GLOBAL_POSITION_INT_DATA {
        let [lat, lon, alt] = geodetic(&self.origin, self.position);
        let [vx, vy, vz] = self.velocity.to_array().map(|v| (v * 100.0).round() as i16);
        GLOBAL_POSITION_INT_DATA {
            time_boot_ms: self.now_ms(),
            lat,
            lon,
            alt,
            relative_alt: (self.height() * 1e3).round() as i32,
            vx,
            vy,
            vz,
            hdg: self.heading_cdeg(),
        }
    }

    /// Height above home, m.
    fn height(&self) -> f64 {
        self.home.down() - self.position.down()
    }

    fn heading_cdeg(&self) -> u16 {
        let degrees = self.attitude.euler().yaw.to_degrees().rem_euclid(360.0);
        ((degrees * 100.0).round() as u16) % 36_000
    }

    pub(super) fn gps_raw(&self) -> GPS_RAW_INT_DATA {
        let [lat, lon, alt] = geodetic(&self.origin, self.position);
        let speed = self.velocity.north().hypot(self.velocity.east());
        let course = self.velocity.east().atan2(self.velocity.north()).to_degrees();
        GPS_RAW_INT_DATA {
            time_usec: self.now_us,
            lat,
            lon,
            alt,
            eph: 70,
            epv: 90,
            vel: (speed * 100.0).round() as u16,
            cog: (course.rem_euclid(360.0) * 100.0).round() as u16 % 36_000,
            fix_type: GpsFixType::GPS_FIX_TYPE_3D_FIX,
            satellites_visible: 12,
            alt_ellipsoid: alt,
            h_acc: 300,
            v_acc: 400,
            vel_acc: 50,
            ..Default::default()
        }
    }

    pub(super) fn vfr_hud(&self) -> VFR_HUD_DATA {
        let throttle = self.outputs.iter().sum::<f64>() / ROTORS as f64;
        VFR_HUD_DATA {
            groundspeed: self.velocity.north().hypot(self.velocity.east()) as f32,
            alt: (self.origin.altitude_m - self.position.down()) as f32,
            climb: -self.velocity.down() as f32,
            heading: (self.heading_cdeg() / 100).cast_signed(),
            throttle: (throttle * 100.0).round() as u16,
            ..Default::default()
        }
    }

    pub(super) fn altitude(&self) -> ALTITUDE_DATA {
        let amsl = (self.origin.altitude_m - self.position.down()) as f32;
        ALTITUDE_DATA {
            time_usec: self.now_us,
            altitude_monotonic: amsl,
            altitude_amsl: amsl,
            altitude_local: -self.position.down() as f32,
            altitude_relative: self.height() as f32,
            altitude_terrain: f32::NAN,
            bottom_clearance: f32::NAN,
        }
    }

    pub(super) fn home_position(&self) -> HOME_POSITION_DATA {
        let [latitude, longitude, altitude] = geodetic(&self.origin, self.home);
        let [x, y, z] = floats(self.home.to_array());
        HOME_POSITION_DATA {
            latitude,
            longitude,
            altitude,
            x,
            y,
            z,
            q: [1.0, 0.0, 0.0, 0.0],
            time_usec: self.now_us,
            ..Default::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_degree_north_is_111_km() {
        let origin = Home { latitude_deg: 47.0, longitude_deg: 8.0, altitude_m: 400.0 };
        let [latitude, longitude, altitude] = geodetic(&origin, Ned::new(111_195.0, 0.0, -10.0));
        assert!((latitude - 480_000_000).abs() < 1000);
        assert_eq!((longitude, altitude), (80_000_000, 410_000));
    }
}
