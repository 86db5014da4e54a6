#!/usr/bin/env bash
# Repeats the figures of the README and of the book, and prints one line per figure.
#
#   docs/figures.sh BIN_DIR DATA_DIR OUT_DIR [NAME...]
#
#   BIN_DIR   folder of the programs, for example target/release
#   DATA_DIR  folder of the recordings, for example target/data; a figure whose recording is not there is skipped
#   OUT_DIR   folder for what the programs write; a figure replaces its own folder OUT_DIR/NAME
#   NAME      the figures to repeat, all if none is named; names are NAME of each `figure_NAME` below
#
#   RUNS=3    in the environment: so many Monte-Carlo runs a condition, instead of the 20 or 40 of the README
#   THREADS=1 in the environment: so many Monte-Carlo runs at once, instead of one a processor
#
# Needs bash 4.4 and python3 (for reading JSON). Only times depend on the machine: the same programs print the same
# figures each time. All of it takes about an hour on one processor, most of it for the Monte-Carlo conditions.
set -euo pipefail

if [ $# -lt 3 ]; then
  sed -n '2,/^set /{/^set /d;s/^# \{0,1\}//;p}' "${BASH_SOURCE[0]}" >&2
  exit 2
fi
bin=$1 data=$2 out=$3
shift 3
mkdir -p "$out"

# ---------------------------------------------------------------------------------------------------------- recorded

# The paper's simulation; mapconst takes the map's poses for exact.
figure_yq() {
  recorded yq/map yq/live || return 0
  build refined yq/map --sigma-pixel 1
  build given yq/map --sigma-pixel 1 --no-refine-poses
  run mm_r yq/live --map "$folder/refined.db" --init truth --mode multi
  run mm_r_given yq/live --map "$folder/given.db" --init truth --mode multi
  run sm_r_given yq/live --map "$folder/given.db" --init truth --mode single
  run mapconst_given yq/live --map "$folder/given.db" --init truth --mode mapconst
  run odometry yq/live --init truth --mode odometry
}

# The same place with the authors' matches.
figure_yq_real() {
  recorded yq_real/map yq_real/live || return 0
  import map yq_real/map
  run sm_r yq_real/live --map "$folder/map.db" --init truth --mode single
}

# EuRoC with the real IMU and the authors' matches; then with the noise that the data sheet states.
figure_mh05() {
  recorded euroc_real/mh05_on_mh01 || return 0
  import map euroc_real/mh05_on_mh01/map
  run sm_r euroc_real/mh05_on_mh01/live --map "$folder/map.db" --init truth --mode single
  run sm_r_data_sheet euroc_real/mh05_on_mh01/live --map "$folder/map.db" --init truth --mode single \
    --imu-noise-scale 1
}

figure_v202() {
  recorded euroc_real/v202_on_v201 || return 0
  import map euroc_real/v202_on_v201/map
  run sm_r euroc_real/v202_on_v201/live --map "$folder/map.db" --init truth --mode single
}

# A hall mapped by one flight and flown through by another.
figure_mh03() {
  recorded odometry/MH_01_easy odometry/MH_03_medium || return 0
  build map odometry/MH_01_easy --sigma-pixel 1
  run sm_r odometry/MH_03_medium --map "$folder/map.db" --init truth --mode single
  run mm_r odometry/MH_03_medium --map "$folder/map.db" --init truth --mode multi
}

# The authors' simulated loops, in a map whose gravity is not along z.
figure_loops() {
  recorded loops/scenario_1 || return 0
  import map loops/scenario_1/map
  run sm_r loops/scenario_1/live --map "$folder/map.db" --init truth --mode single
}

# ------------------------------------------------------------------------------------------------------------ images

truth_as_poses=(--sigma-theta 0.0174533 --sigma-p 0.01 --gravity '0,0,-1')

# Every other image in a map of the images between, each without any prior; then the whole flight with these images.
figure_images_between() {
  recorded images/v1_01_keyframes || return 0
  excerpt images/v1_01_keyframes "$folder/odd" 'row % 2 == 1'
  excerpt images/v1_01_keyframes "$folder/even" 'row % 2 == 0'
  build_from "$folder/odd" map "${truth_as_poses[@]}"
  inspect_all "$folder/even" "$folder/odd" "$folder/map.db"
  run_in flight "$folder/even" --map "$folder/map.db" --cameras mono
}

# Later images in a map of the first 50 s.
figure_images_later() {
  recorded images/v1_01_keyframes || return 0
  excerpt images/v1_01_keyframes "$folder/first" 'stamp - first < 50000000000'
  excerpt images/v1_01_keyframes "$folder/later" 'stamp - first >= 50000000000'
  build_from "$folder/first" map "${truth_as_poses[@]}"
  inspect_all "$folder/later" "$folder/first" "$folder/map.db"
}

# Odometry from the images of one shaken camera.
figure_handheld() {
  recorded images/mh_01_handheld_16s || return 0
  run odometry images/mh_01_handheld_16s --mode odometry --cameras mono --init truth
}

# ------------------------------------------------------------------------------------------------------- simulations

# The table of the demo from tracks.
figure_demo() {
  begin
  "$bin/driftless" demo --tracks --out "$folder/demo" --json > "$folder/demo.json"
  rows demo "$folder/demo.json"
}

# The conditions of docs/src/consistency.md.
figure_loops_200() { montecarlo 20 --trajectory loops --seconds 400 --match-every 2; }
figure_loops_100() { montecarlo 20 --trajectory loops --seconds 400 --match-every 4; }
figure_loops_60() { montecarlo 20 --trajectory loops --seconds 400 --match-every 6.67; }
figure_loops_30() { montecarlo 20 --trajectory loops --seconds 400 --match-every 13.3; }
figure_every_20_s() { montecarlo 20 --trajectory loops --seconds 400 --match-every 20; }
figure_gap_45_s() { montecarlo 20 --seconds 60 --gap 10:55; }
figure_loose_start() { montecarlo 40 --trajectory loops --sigma-start 1:0.05; }
figure_poor_initialization() { montecarlo 40 --matches 12 --max-keyframes 1; }
figure_few_tracks() { montecarlo 40 --tracks 25 --matches 20 --match-every 5; }
figure_one_keyframe() { montecarlo 20 --trajectory room --match-every 0.5 --max-keyframes 1 --keyframe-distance 100; }
figure_wrong_matches() { montecarlo 20 --wrong-matches 0.3; }
figure_loops_200_mono() { montecarlo 20 --cameras mono --trajectory loops --seconds 400 --match-every 2; }
figure_loops_30_mono() { montecarlo 20 --cameras mono --trajectory loops --seconds 400 --match-every 13.3; }

# ----------------------------------------------------------------------------------------------------------- helpers

# Sets `folder`, which is new, for the files of the figure that is repeated.
begin() {
  folder=$out/$figure
  rm -rf "$folder"
  mkdir -p "$folder"
}

# logged LOG COMMAND...: keeps what a command says of its progress out of sight unless it fails.
logged() {
  local log=$1 code=0
  shift
  "$@" 2> "$log" || code=$?
  if [ "$code" -ne 0 ]; then
    tail -n 5 "$log" >&2
  fi
  return "$code"
}

# Begins the figure if all recordings that it needs are there.
recorded() {
  local name
  for name; do
    if [ ! -d "$data/$name" ]; then
      printf '%-18s skipped: no %s\n' "$figure" "$data/$name"
      return 1
    fi
  done
  begin
}

# build MAP RECORDING [SWITCH...]: a map of a recording.
build() {
  local map=$1 recording=$2
  shift 2
  build_from "$data/$recording" "$map" "$@"
}

# build_from FOLDER MAP [SWITCH...]
build_from() {
  local from=$1 map=$2
  shift 2
  "$bin/driftless" build-map "$from" --map "$folder/$map.db" --json "$@" > "$folder/$map.build.json"
  "$bin/driftless" map-info --map "$folder/$map.db" --json > "$folder/$map.info.json"
}

# import MAP TEXT: a map of the plain text of one.
import() {
  "$bin/driftless" import-map "$data/$2" --map "$folder/$1.db" --json > "$folder/$1.import.json"
  "$bin/driftless" map-info --map "$folder/$1.db" --json > "$folder/$1.info.json"
}

# run NAME RECORDING [SWITCH...]: a robot through a recording, and the line of its score.
run() {
  local name=$1 recording=$2
  shift 2
  run_in "$name" "$data/$recording" "$@"
}

# run_in NAME FOLDER [SWITCH...]
run_in() {
  local name=$1 from=$2
  shift 2
  logged "$folder/$name.log" "$bin/driftless" run "$from" --out "$folder/$name" --json "$@" > /dev/null
  rows "run:$name" "$folder/$name/summary.json"
}

# excerpt RECORDING FOLDER CONDITION: the images of a recording for whose `row` (from 0) and `stamp` (ns; `first` is
# that of the first) the condition holds, with all of its IMU and truth.
excerpt() {
  local from part
  from=$(cd "$data/$1" && pwd)
  for part in "$from"/mav0/*; do
    part=$(basename "$part")
    if [ -f "$from/mav0/$part/data.csv" ] && [ -d "$from/mav0/$part/data" ]; then
      mkdir -p "$2/mav0/$part"
      ln -s "$from/mav0/$part/data" "$from/mav0/$part/sensor.yaml" "$2/mav0/$part/"
      python3 -c '
import sys
lines = sys.stdin.read().splitlines()
stamps = [int(line.split(",")[0]) for line in lines[1:]]
print(lines[0])
for row, (stamp, line) in enumerate(zip(stamps, lines[1:])):
    if eval(sys.argv[1], {"row": row, "stamp": stamp, "first": stamps[0]}):
        print(line)
' "$3" < "$from/mav0/$part/data.csv" > "$2/mav0/$part/data.csv"
    else
      mkdir -p "$2/mav0"
      ln -s "$from/mav0/$part" "$2/mav0/$part"
    fi
  done
}

# inspect_all QUERIES MAPPED MAP: looks for each image of one recording in a map of another, and counts those found.
inspect_all() {
  local camera=$1/mav0/cam0 file code
  mkdir -p "$folder/answers"
  while IFS=, read -r _ file; do
    code=0
    "$bin/driftless" inspect "$camera/data/$file" --camera "$camera/sensor.yaml" --map "$3" \
      --out "$folder/inspection.svg" --json > "$folder/answers/${file%.*}.json" || code=$?
    # 2 says that the image was not recognized.
    if [ "$code" -ne 0 ] && [ "$code" -ne 2 ]; then
      return "$code"
    fi
  done < <(grep -v '^#' "$camera/data.csv" | tr -d '\r')
  rows images "$folder/answers" "$1" "$2" "$folder/errors.json"
}

# montecarlo RUNS [SWITCH...]: one condition, for the default filter and for one as in the paper.
montecarlo() {
  local runs=${RUNS:-$1}
  shift
  begin
  echo '{}' > "$folder/ours.yaml"
  echo '{first_estimates: false, slam_features: 0}' > "$folder/paper.yaml"
  logged "$folder/montecarlo.log" "$bin/driftless" montecarlo \
    --runs "$runs" ${THREADS:+--threads "$THREADS"} --mode multi "$@" \
    --estimator-config "$folder/ours.yaml" --estimator-config "$folder/paper.yaml" --json > "$folder/montecarlo.json"
  rows montecarlo "$folder/montecarlo.json"
}

# rows KIND FILE...: prints the lines of a result.
rows() {
  python3 - "$figure" "$@" << 'PYTHON'
import csv, json, math, os, re, sys

figure, kind, *files = sys.argv[1:]


def load(path):
    with open(path) as file:
        return json.load(file)


def number(value, width, digits):
    return f"{'-':>{width}}" if value is None else f"{value:{width}.{digits}f}"


def pose(name, metres, degrees, nees):
    return f"{name} {number(metres, 8, 4)} m {number(degrees, 7, 4)} deg {number(nees, 8, 3)} NEES"


def line(variant, *parts):
    print(f"{figure:<18} {variant:<18} " + "   ".join(parts), flush=True)


def run(variant):
    summary = load(files[0])
    score, queries = summary["score"], summary["queries"]
    answers = f"{queries['accepted']}/{queries['answered']} answers"
    if score is None:
        line(variant, "no truth", answers)
        return
    of = lambda name, key: pose(name, *((score[key] or {}).get(k) for k in ("rmse_m", "rmse_deg", "nees_pose")))
    line(
        variant,
        of("pose", "pose"),
        of("local", "local"),
        f"aligned {number(score['odometry_yaw_aligned_m']['rmse'], 7, 4)} m",
        f"largest {number((score['pose'] or score['local'])['max_m'], 7, 4)} m",
        answers,
    )


def montecarlo():
    for score in load(files[0]):
        def of(name, key):
            part = score[key]
            return pose(name, part and part["rmse_m"], part and part["rmse_deg"], part and part["pose"]["mean"])

        variant = score["name"].removeprefix("multi ")
        line(variant, of("pose", "pose"), of("local", "local"), of("G_T_L", "transform"), f"{score['runs']} runs")


def demo():
    for row in load(files[0])["rows"]:
        def of(name, key):
            part = row.get(key) or {}
            return pose(name, part.get("rmse_m"), part.get("rmse_deg"), part.get("nees_pose"))

        line(row["name"], of("pose", "pose"), of("local", "local"), of("G_T_L", "transform"))


# --- images: unit quaternions (w, x, y, z) and positions


def times(a, b):
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )


def inverse(q):
    return (q[0], -q[1], -q[2], -q[3])


def turn(q, v):
    return times(times(q, (0.0, *v)), inverse(q))[1:]


def angle(a, b):
    w, *v = times(inverse(a), b)
    return math.degrees(2.0 * math.atan2(math.hypot(*v), abs(w)))


def quaternion(m):
    w = math.sqrt(max(0.0, 1 + m[0][0] + m[1][1] + m[2][2])) / 2
    if w > 0.1:
        return (w, (m[2][1] - m[1][2]) / (4 * w), (m[0][2] - m[2][0]) / (4 * w), (m[1][0] - m[0][1]) / (4 * w))
    # Turned by more than 168 degrees: turn the axes first, which is undone after.
    for axis in ((0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)):
        columns = [turn(axis, unit) for unit in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        turned = [[sum(m[r][k] * columns[c][k] for k in range(3)) for c in range(3)] for r in range(3)]
        if 1 + turned[0][0] + turned[1][1] + turned[2][2] > 0.1:
            return times(quaternion(turned), inverse(axis))


def truth_of(recording):
    """Where the first camera truly was at an instant; None where the truth has a gap."""
    text = open(f"{recording}/mav0/cam0/sensor.yaml").read()
    found = re.search(r"T_BS:.*?data:\s*\[(.*?)\]", text, re.S)
    t = [float(value) for value in found.group(1).split(",")]
    camera_q, camera_p = quaternion([t[0:3], t[4:7], t[8:11]]), (t[3], t[7], t[11])
    rows = []
    for row in csv.reader(open(f"{recording}/mav0/state_groundtruth_estimate0/data.csv")):
        if not row[0].startswith("#"):
            rows.append((int(row[0]), tuple(map(float, row[1:4])), tuple(map(float, row[4:8]))))

    def at(stamp):
        after = next((i for i, row in enumerate(rows) if row[0] >= stamp), None)
        if not after or rows[after][0] - rows[after - 1][0] > 110_000_000:
            return None
        (t0, p0, q0), (t1, p1, q1) = rows[after - 1], rows[after]
        weight = (stamp - t0) / (t1 - t0)
        if sum(a * b for a, b in zip(q0, q1)) < 0:
            q1 = tuple(-value for value in q1)
        # Rows are so near to each other that the straight line is as good as the arc.
        q = tuple(a + weight * (b - a) for a, b in zip(q0, q1))
        q = tuple(value / math.hypot(*q) for value in q)
        p = tuple(a + weight * (b - a) for a, b in zip(p0, p1))
        return tuple(a + b for a, b in zip(p, turn(q, camera_p))), times(q, camera_q)

    return at


def images():
    answers, queries, mapped, errors_file = files
    truth = truth_of(queries)
    axis = lambda q: turn(q, (0.0, 0.0, 1.0))
    places = [truth(int(row[0])) for row in csv.reader(open(f"{mapped}/mav0/cam0/data.csv")) if row[0][0] != "#"]
    errors = {}
    for row in csv.reader(open(f"{queries}/mav0/cam0/data.csv")):
        if row[0].startswith("#") or not (true := truth(int(row[0]))):
            continue
        near = any(
            math.dist(place[0], true[0]) <= 1.0
            and math.degrees(math.acos(min(1.0, sum(a * b for a, b in zip(axis(place[1]), axis(true[1])))))) <= 35.0
            for place in places
            if place
        )
        fix = load(f"{answers}/{os.path.splitext(row[1].strip())[0]}.json")["answer"]["fix"]
        error = {"near": near, "metres": None, "degrees": None}
        if fix:
            found = fix["global_from_camera"]
            error["metres"] = math.dist(found["translation"], true[0])
            error["degrees"] = angle(found["rotation_wxyz"], true[1])
        errors[row[0]] = error
    with open(errors_file, "w") as file:
        json.dump(errors, file, indent=1)
    near = [error for error in errors.values() if error["near"]]
    found = [error for error in errors.values() if error["metres"] is not None]
    good = [error for error in near if error["metres"] is not None and error["metres"] <= 0.05 and error["degrees"] <= 1]
    wrong = [error for error in found if error["metres"] > 0.5]
    mean = lambda key: sum(error[key] for error in good) / max(len(good), 1)
    line(
        "each image",
        f"{len(errors)} images, {len(near)} near the map: {len(good)} within 5 cm and 1 deg, "
        f"{len(wrong)} wrong by 0.5 m (mean {mean('metres'):.5f} m {mean('degrees'):.4f} deg)",
    )


if kind.startswith("run:"):
    run(kind[len("run:") :])
else:
    {"montecarlo": montecarlo, "demo": demo, "images": images}[kind]()
PYTHON
}

if [ $# -eq 0 ]; then
  # In the order in which they stand above.
  mapfile -t names < <(sed -n 's/^figure_\([a-z0-9_]*\)().*/\1/p' "${BASH_SOURCE[0]}")
  set -- "${names[@]}"
fi
for figure; do
  if [ "$(type -t "figure_$figure")" != function ]; then
    echo "$figure is no figure; see ${BASH_SOURCE[0]}" >&2
    exit 2
  fi
done
for figure; do
  "figure_$figure"
done
