//! Which topics of a bag are the IMU: one, or one of the gyroscope and one of the accelerometer.

use super::messages;
use super::topics::{IMU, listed, named, of_types, wrong};
use crate::{CalibrationFiles, SequenceError};
use bags::Bag;
use ros_messages::geometry_msgs::Vector3;
use ros_messages::sensor_msgs::Imu;

/// So many messages, spread over the recording, tell what a topic measures.
const LOOKED_AT: usize = 50;

/// What the messages of a topic hold. Drivers leave zeros, or what is no number, in place of what they do not measure.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Measured {
    Both,
    Gyroscope,
    Accelerometer,
}

/// Finds the topic of the IMU, or of its gyroscope, and that of the accelerometer where it has one of its own.
pub(super) fn find(
    bag: &Bag,
    files: &CalibrationFiles,
) -> Result<(Option<usize>, Option<usize>), SequenceError> {
    let accelerometer = files.accelerometer_topic.as_ref();
    let accelerometer =
        accelerometer.map(|name| named(bag, name, "--accelerometer-topic", &[IMU])).transpose()?;
    let found: Vec<usize> = of_types(bag, &[IMU]).collect();
    let only = |kind: Measured| {
        let mut fitting = found.iter().copied().filter(|&topic| measured(bag, topic) == kind);
        fitting.next().filter(|_| fitting.next().is_none())
    };
    let imu = match &files.imu_topic {
        Some(name) => named(bag, name, "--imu-topic", &[IMU])?,
        None => match found.as_slice() {
            [] => return Ok((None, None)),
            [single] => *single,
            _ if accelerometer.is_some() => only(Measured::Gyroscope).ok_or_else(|| several(bag))?,
            _ => match (only(Measured::Both), only(Measured::Gyroscope), only(Measured::Accelerometer)) {
                (Some(both), _, _) => both,
                (None, Some(gyroscope), Some(_)) => gyroscope,
                _ => return Err(several(bag)),
            },
        },
    };
    if let Some(accelerometer) = accelerometer {
        return Ok((Some(imu), Some(accelerometer).filter(|accelerometer| *accelerometer != imu)));
    }
    match measured(bag, imu) {
        Measured::Both => return Ok((Some(imu), None)),
        Measured::Accelerometer => {
            let name = &bag.topics()[imu].name;
            let list = listed(bag, found.iter().copied().filter(|topic| *topic != imu));
            return Err(wrong(
                bag,
                format!(
                    "{name} has accelerations only, all its angular velocities are zero: name the topic of the gyroscope with \
                     --imu-topic, or record it; others of this type:{list}"
                ),
            ));
        }
        Measured::Gyroscope => {}
    }
    let accelerometer = only(Measured::Accelerometer).ok_or_else(|| {
        let name = &bag.topics()[imu].name;
        let list = listed(bag, found.iter().copied().filter(|topic| *topic != imu));
        wrong(
            bag,
            format!(
                "{name} has angular velocities only, all its accelerations are zero: name the topic of the accelerometer with \
                 --accelerometer-topic, or record it; others of this type:{list}"
            ),
        )
    })?;
    Ok((Some(imu), Some(accelerometer)))
}

fn several(bag: &Bag) -> SequenceError {
    let list = listed(bag, of_types(bag, &[IMU]));
    wrong(
        bag,
        format!(
            "several topics could be the IMU; name one with --imu-topic, and with --accelerometer-topic that of the \
             accelerometer where it has its own:{list}"
        ),
    )
}

/// What a topic measures; both, where it cannot be told.
fn measured(bag: &Bag, topic: usize) -> Measured {
    let recorded = &bag.topics()[topic].messages;
    let step = (recorded.len() / LOOKED_AT).max(1);
    let is_given = |vector: Vector3| {
        let values: [f64; 3] = vector.into();
        values.iter().all(|value| value.is_finite()) && values.iter().any(|value| *value != 0.0)
    };
    let (mut gyroscope, mut accelerometer) = (false, false);
    for message in recorded.iter().step_by(step) {
        let Ok(message) = messages::read::<Imu>(bag, topic, message.place) else { continue };
        gyroscope |= is_given(message.angular_velocity);
        accelerometer |= is_given(message.linear_acceleration);
        if gyroscope && accelerometer {
            break;
        }
    }
    match (gyroscope, accelerometer) {
        (true, false) => Measured::Gyroscope,
        (false, true) => Measured::Accelerometer,
        _ => Measured::Both,
    }
}
