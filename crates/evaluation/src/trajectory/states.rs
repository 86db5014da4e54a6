//! `states.csv`: every output of a run, each pose with its covariance.
//!
//! One line a pose: time, which pose, position, quaternion (w first), and the upper triangle of the 6x6 covariance of
//! `[dtheta, dp]` (rad, metres, parent frame), row by row: `c_00, c_01 .. c_05, c_11 .. c_55`.

use geometry::uncertain_pose::PoseWithCovariance;
use nalgebra::Matrix6;
use sensors::{Row, SequenceError, Table, check_order, pose_cells, warn_cut_off};
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

/// Entries of the upper triangle of a 6x6 matrix.
const TRIANGLE: usize = 21;

/// Which pose a line of `states.csv` is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum StateKind {
    /// The IMU in the odometry frame.
    LocalFromImu,
    /// The odometry frame in the map.
    GlobalFromLocal,
    /// The IMU in the map.
    GlobalFromImu,
}

impl StateKind {
    /// All of them, in the order in which they are written.
    pub const ALL: [Self; 3] = [Self::LocalFromImu, Self::GlobalFromLocal, Self::GlobalFromImu];

    /// As written in the file.
    pub fn name(self) -> &'static str {
        match self {
            Self::LocalFromImu => "local_from_imu",
            Self::GlobalFromLocal => "global_from_local",
            Self::GlobalFromImu => "global_from_imu",
        }
    }

    fn parse(name: &[u8]) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.name().as_bytes() == name)
    }
}

/// The outputs of a run at one instant.
#[derive(Clone, Debug, PartialEq)]
pub struct StateRow {
    /// Time, nanoseconds.
    pub stamp_ns: i64,
    /// The IMU in the odometry frame.
    pub local_from_imu: PoseWithCovariance,
    /// The odometry frame in the map, once localized.
    pub global_from_local: Option<PoseWithCovariance>,
    /// The IMU in the map, once localized.
    pub global_from_imu: Option<PoseWithCovariance>,
}

impl StateRow {
    /// One of the three poses.
    pub fn get(&self, kind: StateKind) -> Option<&PoseWithCovariance> {
        match kind {
            StateKind::LocalFromImu => Some(&self.local_from_imu),
            StateKind::GlobalFromLocal => self.global_from_local.as_ref(),
            StateKind::GlobalFromImu => self.global_from_imu.as_ref(),
        }
    }
}

/// Writes `states.csv` row by row while a run goes on.
#[derive(Debug)]
pub struct StateWriter {
    path: PathBuf,
    out: BufWriter<File>,
}

impl StateWriter {
    /// Creates the file and writes its header.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn create(path: &Path) -> Result<Self, SequenceError> {
        let create = || {
            let mut out = BufWriter::new(File::create(path)?);
            write!(out, "#timestamp [ns],state,p_x [m],p_y [m],p_z [m],q_w,q_x,q_y,q_z")?;
            for (row, column) in triangle() {
                write!(out, ",c_{row}{column}")?;
            }
            writeln!(out)?;
            Ok(out)
        };
        let out = create().map_err(|source| SequenceError::io(path, source))?;
        Ok(Self { path: path.to_path_buf(), out })
    }

    /// Appends the outputs of one instant.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn append(&mut self, row: &StateRow) -> Result<(), SequenceError> {
        for kind in StateKind::ALL {
            if let Some(state) = row.get(kind) {
                append_state(&mut self.out, row.stamp_ns, kind, state)
                    .map_err(|source| SequenceError::io(&self.path, source))?;
            }
        }
        Ok(())
    }

    /// Writes what is still buffered. Dropping the writer does so too, but cannot say that it failed.
    ///
    /// # Errors
    /// [`SequenceError::Io`] with the file.
    pub fn flush(&mut self) -> Result<(), SequenceError> {
        self.out.flush().map_err(|source| SequenceError::io(&self.path, source))
    }
}

/// Writes a whole `states.csv`.
///
/// # Errors
/// [`SequenceError::Io`] with the file.
pub fn write(path: &Path, rows: &[StateRow]) -> Result<(), SequenceError> {
    let mut writer = StateWriter::create(path)?;
    rows.iter().try_for_each(|row| writer.append(row))?;
    writer.flush()
}

/// Reads `states.csv`. A last row that is cut off, as when a run is killed, is left out with a warning.
///
/// # Errors
/// [`SequenceError`] with the file and the line: an unknown state, a row that is cut off or not finite, time stamps
/// out of order, an instant without `local_from_imu`; no states at all.
pub fn read(path: &Path) -> Result<Vec<StateRow>, SequenceError> {
    let rows: Vec<StateRow> = StateReader::open(path)?.collect::<Result<_, _>>()?;
    if rows.is_empty() {
        return Err(SequenceError::empty(path, "the run has no output; see its log"));
    }
    Ok(rows)
}

/// Reads `states.csv` instant by instant, in constant memory. It ends with the first error, or before a last row that is
/// cut off, with a warning.
pub struct StateReader {
    /// `None` after the last row or an error.
    table: Option<Table>,
    /// The instant whose rows are being read.
    pending: Option<StateRow>,
    path: PathBuf,
    cut_off_line: Option<u64>,
}

impl StateReader {
    /// Opens the file.
    ///
    /// # Errors
    /// [`SequenceError`] with the file.
    pub fn open(path: &Path) -> Result<Self, SequenceError> {
        let table = Some(Table::open(path, "a run writes it to its --out folder")?);
        Ok(Self { table, pending: None, path: path.to_path_buf(), cut_off_line: None })
    }

    /// The last line, where it has no line feed: a program was killed while it wrote it, and it was left out.
    pub fn cut_off_line(&self) -> Option<u64> {
        self.cut_off_line
    }

    fn read_next(&mut self) -> Result<Option<StateRow>, SequenceError> {
        let Some(table) = &mut self.table else { return Ok(None) };
        while table.next_row()?.is_some() {
            if table.row_is_unterminated() {
                self.cut_off_line = Some(table.row().line());
                warn_cut_off(&self.path, table.row().line());
                break;
            }
            let row = table.row();
            let (stamp_ns, kind, state) = parse_state(&row)?;
            if kind == StateKind::LocalFromImu {
                check_order(&row, self.pending.as_ref().map(|before| before.stamp_ns), stamp_ns)?;
                let row_begun = StateRow {
                    stamp_ns,
                    local_from_imu: state,
                    global_from_local: None,
                    global_from_imu: None,
                };
                match self.pending.replace(row_begun) {
                    Some(whole) => return Ok(Some(whole)),
                    None => continue,
                }
            }
            let Some(pending) = self.pending.as_mut().filter(|pending| pending.stamp_ns == stamp_ns) else {
                return Err(row.wrong("local_from_imu of the same time must come first"));
            };
            let slot = match kind {
                StateKind::GlobalFromLocal => &mut pending.global_from_local,
                _ => &mut pending.global_from_imu,
            };
            *slot = Some(state);
        }
        self.table = None;
        Ok(self.pending.take())
    }
}

impl Iterator for StateReader {
    type Item = Result<StateRow, SequenceError>;

    fn next(&mut self) -> Option<Self::Item> {
        let next = self.read_next();
        if next.is_err() {
            self.table = None;
        }
        next.transpose()
    }
}

fn parse_state(row: &Row<'_>) -> Result<(i64, StateKind, PoseWithCovariance), SequenceError> {
    row.require(9 + TRIANGLE)?;
    let Some(kind) = StateKind::parse(row.cell(1)?) else {
        let name = String::from_utf8_lossy(row.cell(1)?).into_owned();
        return Err(row.wrong(format!(
            "state \"{name}\" is unknown: local_from_imu, global_from_local and global_from_imu are known"
        )));
    };
    let state = PoseWithCovariance::new(pose_cells(row, 2)?, symmetric(&row.finite_array(9)?));
    Ok((row.stamp()?, kind, state))
}

fn triangle() -> impl Iterator<Item = (usize, usize)> {
    (0..6).flat_map(|row| (row..6).map(move |column| (row, column)))
}

fn symmetric(entries: &[f64; TRIANGLE]) -> Matrix6<f64> {
    let mut matrix = Matrix6::zeros();
    for ((row, column), entry) in triangle().zip(entries) {
        matrix[(row, column)] = *entry;
        matrix[(column, row)] = *entry;
    }
    matrix
}

fn append_state(
    out: &mut BufWriter<File>,
    stamp_ns: i64,
    kind: StateKind,
    state: &PoseWithCovariance,
) -> std::io::Result<()> {
    let (p, q) = (state.pose.translation, state.pose.rotation.quaternion());
    write!(out, "{stamp_ns},{}", kind.name())?;
    for value in [p.x, p.y, p.z, q.w, q.i, q.j, q.k] {
        write!(out, ",{value:.9}")?;
    }
    for index in triangle() {
        write!(out, ",{:.9e}", state.covariance[index])?;
    }
    writeln!(out)
}

#[cfg(test)]
mod tests {
    use super::*;
    use geometry::pose::Pose;
    use nalgebra::{UnitQuaternion, Vector3};
    use rand::rngs::StdRng;
    use rand::{RngExt, SeedableRng};

    fn state(rng: &mut StdRng) -> PoseWithCovariance {
        let mut three = || Vector3::from_fn(|_, _| rng.random_range(-2.0..2.0));
        let pose = Pose::new(UnitQuaternion::from_scaled_axis(three()), three() * 50.0);
        let root = Matrix6::from_fn(|_, _| rng.random_range(-0.1..0.1));
        PoseWithCovariance::new(pose, root * root.transpose())
    }

    fn rows() -> Vec<StateRow> {
        let mut rng = StdRng::seed_from_u64(7);
        (0..20)
            .map(|index| StateRow {
                stamp_ns: 1_503_911_171_749_927_282 + index,
                local_from_imu: state(&mut rng),
                global_from_local: (index > 5).then(|| state(&mut rng)),
                global_from_imu: (index > 5).then(|| state(&mut rng)),
            })
            .collect()
    }

    #[test]
    fn reading_undoes_writing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.csv");
        write(&path, &rows()).unwrap();
        let read = read(&path).unwrap();
        assert_eq!(read.len(), 20);
        for (a, b) in read.iter().zip(&rows()) {
            assert_eq!(a.stamp_ns, b.stamp_ns);
            for kind in StateKind::ALL {
                assert_eq!(a.get(kind).is_some(), b.get(kind).is_some());
                if let (Some(a), Some(b)) = (a.get(kind), b.get(kind)) {
                    assert!(a.pose.local(&b.pose).amax() < 1e-8);
                    assert!((a.covariance - b.covariance).amax() < 1e-9);
                    assert_eq!(a.covariance, a.covariance.transpose());
                }
            }
        }
    }

    #[test]
    fn faults_are_named_with_their_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.csv");
        write(&path, &rows()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to, word) in [
            ("local_from_imu", "world_from_imu", "unknown"),
            ("local_from_imu", "global_from_imu", "must come first"),
            ("1503911171749927283,", "1503911171749927282,", "sort the file"),
        ] {
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let error = read(&path).unwrap_err().to_string();
            assert!(error.contains("line ") && error.contains(word), "{error}");
        }
        let middle = text.find("\n1503911171749927283").unwrap();
        let shortened = format!("{}{}", &text[..middle - 20], &text[middle..]);
        std::fs::write(&path, shortened).unwrap();
        let error = read(&path).unwrap_err().to_string();
        assert!(error.contains("line 2") && error.contains("cut off"), "{error}");
    }

    #[test]
    fn a_last_row_that_a_killed_run_cut_off_is_left_out() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("states.csv");
        write(&path, &rows()).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let lines = text.lines().count() as u64;
        let row_length = text.lines().last().unwrap().len();
        for (cut, expected) in
            [(1, Some(lines)), (3, Some(lines)), (row_length, Some(lines)), (row_length + 1, None)]
        {
            std::fs::write(&path, &text[..text.len() - cut]).unwrap();
            let mut reader = StateReader::open(&path).unwrap();
            let read: Vec<StateRow> = reader.by_ref().collect::<Result<_, _>>().unwrap();
            assert_eq!(reader.cut_off_line(), expected, "{cut}");
            // The last row is the global pose of the last instant; its local pose is complete.
            assert_eq!((read.len(), read[18].global_from_imu.is_some()), (20, true));
            assert!(read[19].global_from_local.is_some() && read[19].global_from_imu.is_none());
        }
    }
}
