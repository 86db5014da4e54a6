//! Positions of GNSS in a folder hold the pose of a run without a map.

use crate::scratch::Scratch;
use std::fmt::Write as _;

/// Latitude, longitude and altitude of the frame of the positions.
const ORIGIN: [f64; 3] = [48.0, 11.0, 500.0];

/// The antenna of a recording by its ground truth, one position a second with errors of 0.3 m that change slowly.
fn positions(truth: &str) -> Vec<(i64, [f64; 3])> {
    let rows = truth.lines().filter(|line| !line.starts_with('#'));
    let numbers = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        let position: Vec<f64> = cells[1..4].iter().map(|cell| cell.parse().unwrap()).collect();
        (cells[0].parse::<i64>().unwrap(), position)
    };
    let mut next_ns = i64::MIN;
    let mut found = Vec::new();
    for (stamp_ns, position) in rows.map(numbers) {
        if stamp_ns < next_ns {
            continue;
        }
        next_ns = stamp_ns + 1_000_000_000;
        let t = found.len() as f64;
        let error = [0.3 * (0.9 * t).sin(), 0.3 * (1.3 * t).cos(), 0.3 * (2.1 * t).sin()];
        found.push((stamp_ns, [0, 1, 2].map(|axis| position[axis] + error[axis])));
    }
    found
}

fn summary(scratch: &Scratch, switches: &str, out: &str) -> serde_json::Value {
    scratch.run(&format!("run town/live --mode odometry {switches} --out {out}"));
    let summary = std::fs::read_to_string(scratch.path(out).join("summary.json")).unwrap();
    serde_json::from_str(&summary).unwrap()
}

#[test]
fn positions_in_a_folder_localize_a_run_without_a_map() {
    let scratch = Scratch::new();
    scratch.run("simulate --out town --seed 5 --duration 45");
    let truth = scratch.path("town/live/mav0/state_groundtruth_estimate0/data.csv");
    let positions = positions(&std::fs::read_to_string(truth).unwrap());
    let gnss = scratch.path("town/live/mav0/gnss0");
    std::fs::create_dir(&gnss).unwrap();

    // In the frame of the map.
    let mut table = "#timestamp [ns],x [m],y [m],z [m],sigma_x,sigma_y,sigma_z\n".to_owned();
    for (stamp_ns, [x, y, z]) in &positions {
        let _ = writeln!(table, "{stamp_ns},{x},{y},{z},0.3,0.3,0.3");
    }
    std::fs::write(gnss.join("data.csv"), table).unwrap();
    std::fs::write(gnss.join("sensor.yaml"), "antenna: [0, 0, 0]\ncorrelation_time: 1\n").unwrap();
    let found = summary(&scratch, "", "metres");
    println!("{:#}\n{:#}", found["gnss"], found["score"]["pose"]);
    assert_eq!(found["gnss"]["initializations"], 1);
    assert!(found["gnss"]["used"].as_u64().unwrap() > 20);
    assert!(found["score"]["pose"].is_object());
    assert!(found["final_status"]["reason"].as_str().unwrap().contains("GNSS corrected the pose"));

    // In millimetres they are of no use, and that is said.
    let mut table = "#timestamp [ns],x [m],y [m],z [m],sigma_x,sigma_y,sigma_z\n".to_owned();
    for (stamp_ns, position) in &positions {
        let [x, y, z] = position.map(|metres| 1e3 * metres);
        let _ = writeln!(table, "{stamp_ns},{x},{y},{z},0.3,0.3,0.3");
    }
    std::fs::write(gnss.join("data.csv"), table).unwrap();
    let wrong = summary(&scratch, "", "millimetres");
    assert_eq!((&wrong["gnss"]["initializations"], &wrong["gnss"]["used"]), (&0.into(), &0.into()));
    let alarm = wrong["alarms"][0]["reason"].as_str().unwrap();
    assert!(alarm.contains("do not follow the odometry"), "{alarm}");

    // The same in degrees.
    let radius = 6.38e6_f64;
    let mut table = "#timestamp [ns],latitude [deg],longitude [deg],altitude [m]\n".to_owned();
    for (stamp_ns, [x, y, z]) in &positions {
        let latitude = ORIGIN[0] + (y / radius).to_degrees();
        let longitude = ORIGIN[1] + (x / radius / ORIGIN[0].to_radians().cos()).to_degrees();
        let _ = writeln!(table, "{stamp_ns},{latitude},{longitude},{}", ORIGIN[2] + z);
    }
    std::fs::write(gnss.join("data.csv"), table).unwrap();
    let yaml =
        format!("antenna: [0, 0, 0]\norigin: {ORIGIN:?}\nnoise: [0.3, 0.3, 0.3]\ncorrelation_time: 1\n");
    std::fs::write(gnss.join("sensor.yaml"), yaml).unwrap();
    let degrees = summary(&scratch, "", "degrees");
    assert_eq!(degrees["gnss"]["initializations"], 1);

    let without = summary(&scratch, "--no-gnss --duration 5", "without");
    assert!(without["gnss"].is_null() && without["score"]["pose"].is_null());
}
