//! What is wrong with the sensors of a run.

use super::bad_readings::BadReadings;
use estimator::{BadImuSample, ImuSample};
use sensors::live::{FaultKind, LiveReport, Stream};
use sensors::{ImuCheck, ImuUnitError};

/// Kinds of faults of sensors.
#[derive(Debug, PartialEq)]
pub(crate) enum SensorFault {
    ImuUnits,
    BadReadings,
    Live(Stream, FaultKind),
}

/// What contradicts itself in the readings, and what a live source says of itself.
pub(crate) struct SensorFaults {
    check: ImuCheck,
    units: Option<ImuUnitError>,
    bad_readings: BadReadings,
    /// What a live source said last.
    pub(crate) live: LiveReport,
}

impl SensorFaults {
    /// Nothing is wrong yet.
    ///
    /// # Arguments
    /// * `gravity_magnitude`: by the calibration of the IMU, m/s^2.
    pub(crate) fn new(gravity_magnitude: Option<f64>) -> Self {
        Self {
            check: ImuCheck::new(gravity_magnitude),
            units: None,
            bad_readings: BadReadings::default(),
            live: LiveReport::default(),
        }
    }

    /// Looks at a reading, and at what became of it.
    pub(crate) fn note(&mut self, reading: &ImuSample, checked: Result<(), BadImuSample>) {
        if self.units.is_none() {
            self.units = self.check.add(reading).err();
        }
        self.bad_readings.note(reading.stamp_ns, checked);
    }

    /// Number of readings that were left out.
    pub(crate) fn bad_readings(&self) -> usize {
        self.bad_readings.count()
    }

    /// What is wrong now.
    pub(crate) fn now(&self) -> impl Iterator<Item = (SensorFault, String)> + '_ {
        let of_units = self.units.map(|fault| (SensorFault::ImuUnits, fault.to_string()));
        let of_readings = self.bad_readings.fault().map(|fault| (SensorFault::BadReadings, fault));
        let of_live = self.live.faults.iter();
        let of_live = of_live.map(|fault| (SensorFault::Live(fault.stream, fault.kind), fault.to_string()));
        of_units.into_iter().chain(of_readings).chain(of_live)
    }
}
