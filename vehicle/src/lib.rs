//! A quadrotor model: the vehicle file, the catalogue of effects that a real vehicle adds to it,
//! and the plant that integrates both.
//!
//! [`VehicleParams`] is the nominal vehicle, and [`effects`] lists what a real one adds.
//! [`physics::Physics`] holds the equations of both, from rotor states to accelerations. It is
//! generic over [`scalar::Scalar`], and dual numbers give exact Jacobians. [`plant::Plant`]
//! integrates one vehicle with rotors, pack and floor; [`batch::Batch`] integrates many at once.
//! [`frame`] types vectors and attitudes by their frame. Units are SI; the world frame is NED, the
//! body frame FRD.
//!
//! ```
//! use vehicle::VehicleParams;
//! use vehicle::effects::EffectSet;
//! use vehicle::plant::{Plant, Setup};
//!
//! let quad = VehicleParams::load("quad1200")?;
//! let mut plant = Plant::new(&quad, &EffectSet::new(), &Setup::default(), 1)?;
//! for _ in 0..500 {
//!     plant.step([0.8; 4]);
//! }
//! assert!(plant.state().position.down() < 0.0, "it climbs");
//! # Ok::<(), vehicle::VehicleError>(())
//! ```

#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod batch;
pub mod battery;
pub mod bounded;
mod contact;
pub mod effects;
pub mod export;
pub mod foreign;
pub mod frame;
pub mod law;
mod params;
pub mod physics;
pub mod plant;
pub mod rigid_body;
pub mod rotor;
pub mod scalar;
mod written;

pub use params::{
    AttitudeCascade, AttitudePd, BatteryParams, Difference, Doubt, MotorOutput, ROTORS, Remark,
    RotorParams, SHIPPED, Shipped, VehicleError, VehicleParams, read, shipped,
};
pub use written::from_toml;
