use onboard::estimator::*;
use onboard::sequence::Sequence;
use onboard::robot::{run::{RobotRun, run}, recorder::Recorder, start::initial_state, arguments::Init};
fn main() {
    let a: Vec<String> = std::env::args().collect();
    let seq = Sequence::open(a[1].as_ref()).unwrap();
    let imu = seq.imu.as_ref().unwrap();
    let cams: usize = a[3].parse().unwrap();
    let mut c = EstimatorConfig { imu_noise: imu.noise, mode: MapMode::Odometry, ..Default::default() };
    if let Ok(v) = std::env::var("FEJ") { c.first_estimates = v == "1"; }
    if let Ok(v) = std::env::var("WINDOW") { c.window = v.parse().unwrap(); }
    if let Ok(v) = std::env::var("GATE") { c.track_gate = v.parse().unwrap(); }
    if let Ok(v) = std::env::var("IMU") { c.imu_noise = c.imu_noise.inflated(v.parse().unwrap()); }
    if let Ok(v) = std::env::var("SIGMA") { c.sigma_track_px = v.parse().unwrap(); }
    if let Ok(v) = std::env::var("BG") { c.initial.gyroscope_bias = v.parse().unwrap(); }
    if let Ok(v) = std::env::var("BA") { c.initial.accelerometer_bias = v.parse().unwrap(); }
    if let Some(g) = imu.gravity_magnitude { c.gravity = g; }
    let init = initial_state(&seq, if a.len() > 4 { Init::Auto } else { Init::Truth }, &c).unwrap();
    let rig: Vec<RigCamera> = seq.cameras.iter().take(cams).map(|x| RigCamera { camera: x.camera.clone(), imu_from_camera: x.imu_from_camera }).collect();
    let e = Estimator::new(c, rig, &init).unwrap();
    let r = RobotRun { sequence: &seq, cameras: cams, estimator: e, robot: "r".into(), max_keyframes: 1, realtime: false, queries: None, publisher: None };
    let mut rec = Recorder::default();
    let res = run(r, &mut rec, |_| {});
    println!("{res:?} {:?} {:?} wall {}", rec.tracks, rec.timings.mean(), rec.wall_seconds);
    let mut s = String::new();
    for row in &rec.states { let p = row.local_from_imu.pose; let q = p.rotation.coords; let t=p.translation;
        s += &format!("{:.9} {} {} {} {} {} {} {}\n", row.stamp_ns as f64*1e-9, t.x,t.y,t.z,q.x,q.y,q.z,q.w); }
    std::fs::write(&a[2], s).unwrap();
}
