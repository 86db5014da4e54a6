//! `driftless vda5050`: robots as vehicles of VDA 5050.

use anyhow::{Context as _, Result, bail};
use client::SessionArguments;
use client::session::{close_session, open_session};
use onboard::StopSignal;
use onboard::arguments::ImuInBaseLink;
use onboard::stop::NetworkRuntime;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;
use vda5050::{
    BridgeEvent, BridgeSettings, BrokerAddress, BrokerTls, BrokerUser, ClientIdentity, VehicleSettings,
};

/// Longest file of a password or a key, and of certificates: those of all authorities of a system have 200 kB. Bytes.
const MAX_SECRET_FILE: u64 = 64 * 1024;
const MAX_CERTIFICATES_FILE: u64 = 4 << 20;
/// Variables of the environment that name user and password where no switch does.
const USER_VARIABLE: &str = "DRIFTLESS_BROKER_USER";
const PASSWORD_VARIABLE: &str = "DRIFTLESS_BROKER_PASSWORD";

/// A robot, and its serial number as a vehicle.
#[derive(Clone, Debug, PartialEq, Eq)]
struct NamedVehicle {
    robot: String,
    serial: String,
}

impl FromStr for NamedVehicle {
    type Err = protocol::keys::NameError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        let (robot, serial) = text.split_once('=').unwrap_or((text, text));
        protocol::keys::validate_name(robot)?;
        Ok(Self { robot: robot.to_owned(), serial: serial.to_owned() })
    }
}

/// Arguments.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  \
    driftless vda5050 --broker mqtt://127.0.0.1:1883 --manufacturer acme --connect tcp/10.0.0.1:7447\n  \
    driftless vda5050 --broker mqtt://broker:1883 --manufacturer acme --robot cart7=0007 --no-connection\n  \
    driftless vda5050 --broker mqtts://broker --broker-ca ca.pem --broker-user fleet --broker-password-file password --manufacturer acme\n\n\
    Publishes uagv/v2/MANUFACTURER/SERIAL/visualization with agvPosition and velocity, and connection, until Ctrl-C.")]
pub struct Args {
    /// The MQTT broker, as mqtt://HOST:PORT, or mqtts://HOST:PORT with TLS
    #[arg(long, value_name = "URL")]
    broker: BrokerAddress,
    /// Certificates of the authorities that may have signed the broker's, PEM [default: those of this system]
    #[arg(long, value_name = "FILE")]
    broker_ca: Option<PathBuf>,
    /// Certificate of the bridge, for brokers that ask for one, PEM
    #[arg(long, value_name = "FILE", requires = "broker_key")]
    broker_certificate: Option<PathBuf>,
    /// Private key of this certificate, PEM, not encrypted
    #[arg(long, value_name = "FILE", requires = "broker_certificate")]
    broker_key: Option<PathBuf>,
    /// User at the broker [default: $DRIFTLESS_BROKER_USER, if it is set]
    #[arg(long, value_name = "NAME")]
    broker_user: Option<String>,
    /// File with the password of this user [default: the password is in $DRIFTLESS_BROKER_PASSWORD]
    #[arg(long, value_name = "FILE")]
    broker_password_file: Option<PathBuf>,
    /// Manufacturer of the vehicles, a level of the topics
    #[arg(long, value_name = "NAME")]
    manufacturer: String,
    /// First level of the topics
    #[arg(long, value_name = "NAME", default_value = vda5050::names::INTERFACE)]
    interface: String,
    /// A robot, and its serial number where that is not its name; may be given several times [default: all robots]
    #[arg(long, value_name = "NAME[=SERIAL]")]
    robot: Vec<NamedVehicle>,
    /// Messages of a vehicle a second
    #[arg(long, value_name = "HZ", default_value_t = 5.0)]
    rate: f64,
    /// Do not publish `connection`: the vehicle's own controller does
    #[arg(long)]
    no_connection: bool,
    /// Pose of the IMU in the vehicle's frame: metres, fixed-axis roll, pitch, yaw in radians [default: the vehicle is where its IMU is]
    #[arg(long, value_name = "X,Y,Z,ROLL,PITCH,YAW", allow_hyphen_values = true)]
    imu_in_base_link: Option<ImuInBaseLink>,
    /// The localizationScore is the probability that the position is within so many metres
    #[arg(long, value_name = "M", default_value_t = VehicleSettings::default().tolerance_m)]
    score_tolerance: f64,
    /// Positions and velocities that are older are not valid any more, seconds
    #[arg(long, value_name = "S", default_value_t = VehicleSettings::default().max_age.as_secs_f64())]
    max_age: f64,
    /// How it is connected to the robots
    #[command(flatten)]
    session: SessionArguments,
}

impl Args {
    /// # Arguments
    /// * `variable`: the value of a variable of the environment.
    fn settings(&self, variable: impl Fn(&str) -> Option<String>) -> Result<BridgeSettings> {
        for (switch, value) in [("--score-tolerance", self.score_tolerance), ("--max-age", self.max_age)] {
            if !(value > 0.0 && value <= 3600.0) {
                bail!("{switch} is {value}; it must be more than 0 and at most 3600");
            }
        }
        let mut settings = BridgeSettings::new(self.broker.clone(), &self.manufacturer);
        settings.tls = self.tls()?;
        settings.user = self.user(variable)?;
        settings.interface.clone_from(&self.interface);
        for NamedVehicle { robot, serial } in &self.robot {
            if settings.serials.insert(robot.clone(), serial.clone()).is_some() {
                bail!("--robot names {robot} twice");
            }
        }
        settings.rate_hz = self.rate;
        settings.announces = !self.no_connection;
        settings.vehicle.tolerance_m = self.score_tolerance;
        settings.vehicle.max_age = Duration::from_secs_f64(self.max_age);
        if let Some(mounting) = self.imu_in_base_link {
            settings.vehicle.imu_from_base = mounting.imu_from_base();
        }
        Ok(settings)
    }

    fn tls(&self) -> Result<BrokerTls> {
        let certificates = |file: &PathBuf| read(file, MAX_CERTIFICATES_FILE);
        let authorities_pem = self.broker_ca.as_ref().map(certificates).transpose()?;
        let mut tls = BrokerTls { authorities_pem, identity: None };
        if let Some((certificate, key)) = self.broker_certificate.as_ref().zip(self.broker_key.as_ref()) {
            let certificates_pem = certificates(certificate)?;
            tls.identity = Some(ClientIdentity { certificates_pem, key_pem: read(key, MAX_SECRET_FILE)? });
        }
        Ok(tls)
    }

    /// User and password: of a switch and a file, or of the environment.
    fn user(&self, variable: impl Fn(&str) -> Option<String>) -> Result<Option<BrokerUser>> {
        let of_file = self.broker_password_file.as_deref().map(read_password).transpose()?;
        let name = self.broker_user.clone().or_else(|| variable(USER_VARIABLE));
        match (name, of_file.or_else(|| variable(PASSWORD_VARIABLE))) {
            (Some(name), Some(password)) => Ok(Some(BrokerUser { name, password })),
            (None, None) => Ok(None),
            (Some(name), None) => bail!(
                "the password of {name} at the broker is missing: give --broker-password-file, or set {PASSWORD_VARIABLE}"
            ),
            (None, Some(_)) => bail!(
                "there is a password for the broker, but no user: give --broker-user, or set {USER_VARIABLE}"
            ),
        }
    }
}

fn read(file: &Path, limit: u64) -> Result<Vec<u8>> {
    files::read(file, limit).with_context(|| file.display().to_string())
}

fn read_password(file: &Path) -> Result<String> {
    let password = String::from_utf8(read(file, MAX_SECRET_FILE)?);
    let password = password.with_context(|| format!("{} is no text", file.display()))?;
    Ok(password.trim_end_matches(['\r', '\n']).to_owned())
}

/// Runs the command.
///
/// # Errors
/// Switches that cannot be used, a session that cannot be opened.
pub fn run(args: &Args) -> Result<()> {
    let settings = args.settings(|name| std::env::var(name).ok())?;
    let stop = StopSignal::on_interrupt().context("signals cannot be handled")?;
    let runtime = NetworkRuntime::new()?;
    let opened = runtime.block_on(stop.until(open_session(&args.session.connecting())));
    let Some(session) = opened else { bail!("interrupted before {} answered", args.session.place()) };
    let session = session.context("the Zenoh session cannot be opened")?;
    let broker = args.broker.to_string();
    let tell = move |event: BridgeEvent| match event {
        BridgeEvent::Vehicle { robot, topic } => println!("{robot}: {topic}"),
        BridgeEvent::Refused(error) => eprintln!("a robot is not published: {error}"),
        BridgeEvent::MapNotLevel { robot, map, tilt_deg } => eprintln!(
            "{robot}: the z axis of the map {map} is {tilt_deg:.1} degrees off the vertical: its positions are published as not initialized; build the map \
             from reference poses with z up, or without any"
        ),
        BridgeEvent::TooManyRobots { limit } => eprintln!(
            "there are names of more than {limit} robots: those that came later are not published. Name the robots (--robot)"
        ),
        BridgeEvent::BrokerReached => println!("{broker} is reached"),
        BridgeEvent::BrokerFailed { error } => {
            eprintln!("{broker} cannot be reached: {error}; it is tried again until it answers");
        }
        _ => {}
    };
    let stopped = async {
        stop.until(std::future::pending::<()>()).await;
    };
    let ended = runtime.block_on(vda5050::run(&session, settings, stopped, tell));
    runtime.block_on(close_session(&session));
    Ok(ended?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::Cli;
    use crate::command::Command;

    fn settings(line: &str) -> Result<BridgeSettings> {
        settings_with(line, |_| None)
    }

    fn settings_with(line: &str, variable: impl Fn(&str) -> Option<String>) -> Result<BridgeSettings> {
        let line = format!("driftless vda5050 --broker mqtt://h:1 --manufacturer acme {line}");
        let cli = Cli::read(line.split_whitespace().map(Into::into))?;
        let Command::Vda5050(args) = cli.command else { bail!("another command") };
        args.settings(variable)
    }

    #[test]
    fn robots_are_named_with_their_serial_numbers() {
        let serials = settings("--robot cart7=0007 --robot cart8").unwrap().serials;
        let named: Vec<(&str, &str)> =
            serials.iter().map(|(one, two)| (one.as_str(), two.as_str())).collect();
        assert_eq!(named, [("cart7", "0007"), ("cart8", "cart8")]);
        for wrong in
            ["--robot a --robot a=2", "--robot a/b", "--robot =7", "--max-age 0", "--score-tolerance nan"]
        {
            assert!(settings(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn a_password_is_read_from_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("password");
        std::fs::write(&file, "two words\n").unwrap();
        let user =
            settings(&format!("--broker-user me --broker-password-file {}", file.display())).unwrap().user;
        assert_eq!(user, Some(BrokerUser { name: "me".to_owned(), password: "two words".to_owned() }));
        assert!(settings("--broker-user me").is_err());
        assert!(settings(&format!("--broker-password-file {}", file.display())).is_err());
    }

    #[test]
    fn user_and_password_come_from_the_environment_where_no_switch_names_them() {
        let both = |name: &str| match name {
            USER_VARIABLE => Some("fleet".to_owned()),
            PASSWORD_VARIABLE => Some("secret".to_owned()),
            _ => None,
        };
        let user = |name: &str| Some(BrokerUser { name: name.to_owned(), password: "secret".to_owned() });
        assert_eq!(settings_with("", both).unwrap().user, user("fleet"));
        assert_eq!(settings_with("--broker-user me", both).unwrap().user, user("me"));
        let error = settings_with("", |name| both(name).filter(|_| name == USER_VARIABLE)).unwrap_err();
        assert!(error.to_string().contains(PASSWORD_VARIABLE), "{error}");
        let error = settings_with("", |name| both(name).filter(|_| name == PASSWORD_VARIABLE)).unwrap_err();
        assert!(
            error.to_string().contains(USER_VARIABLE) && !error.to_string().contains("secret"),
            "{error}"
        );
    }

    #[test]
    fn certificates_are_read_and_a_key_needs_its_certificate() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, name).unwrap();
            path.display().to_string()
        };
        let [ca, own, key] = ["ca.pem", "own.pem", "own.key"].map(path);
        let tls =
            settings(&format!("--broker-ca {ca} --broker-certificate {own} --broker-key {key}")).unwrap().tls;
        let identity = ClientIdentity { certificates_pem: b"own.pem".to_vec(), key_pem: b"own.key".to_vec() };
        assert_eq!((tls.authorities_pem, tls.identity), (Some(b"ca.pem".to_vec()), Some(identity)));
        assert!(settings(&format!("--broker-certificate {own}")).is_err());
        assert!(settings(&format!("--broker-key {key}")).is_err());
        assert!(settings("--broker-ca nowhere.pem").is_err());
    }
}
