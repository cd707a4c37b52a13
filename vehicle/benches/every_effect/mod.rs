//! What benches and tests of the plant fly with.

/// Every effect that acts in the plant, at values that keep it flying.
pub const EVERY_EFFECT: [&str; 19] = [
    "thrust_scale:scale=1.02",
    "mass:mass_kg=1.25",
    "thrust_curve:a=0.2",
    "battery_sag:exponent=1",
    "rotor_loss:rotor=1,scale=0.98",
    "motor_lag:tau_s=0.03",
    "rotor_drag:d_xy=0.3,d_z=0.1",
    "parasitic_drag:cda_m2=0.01",
    "wind:north_m_s=2,east_m_s=-1",
    "gusts:sigma_m_s=0.5",
    "ground_effect:r_eff_m=0.3",
    "translational_lift:k_s2_m2=0.002",
    "blade_flapping:moment_Nms_m=0.01,tilt_rad_s_m=0.002",
    "vortex_ring:loss_max=0.2",
    "inertia:scale=[1.1,1.1,1.1]",
    "com_offset:x_m=0.002,y_m=-0.001",
    "rotor_gyroscopic:rotor_inertia_kgm2=4e-5",
    "yaw_torque:scale=1.1",
    "attitude_trim:roll_rad=0.01",
];
