//! Changed copies of a scene: other carriers, receivers and positions.

use super::{MovingReceiver, Orientation, SceneFile, SceneReceiver, Transmitters};
use glam::{DQuat, DVec3};
use pwrfgs_core::{Error, Pose, Receiver, Result, rng};

impl SceneFile {
    /// Returns the scene with another carrier, which replaces `carriers_hz`, and another position of the first
    /// receiver, metres, if given.
    ///
    /// # Errors
    /// A value out of range.
    pub fn with_overrides(mut self, carrier_hz: Option<f64>, receiver: Option<[f64; 3]>) -> Result<Self> {
        if let Some(only) = carrier_hz {
            (self.carrier_hz, self.carriers_hz) = (only, Vec::new());
        }
        self.receiver.position = receiver.unwrap_or(self.receiver.position);
        self.checked()
    }

    /// Returns the scene with transmitters at these positions, metres.
    ///
    /// # Errors
    /// No position or one that is too far, or a scene whose receiver moves.
    pub fn with_transmitters(mut self, positions: Vec<[f64; 3]>) -> Result<Self> {
        if self.moving_receiver.is_some() {
            return self.refuse("its receiver moves; give poses with --rx-pose or --rx-pose-csv (in Python `rx_pose`)");
        }
        self.transmitter.positions = Transmitters::Listed(positions.into_iter().map(Pose::from).collect());
        self.checked()
    }

    /// Returns the scene with its receiver at these poses, about a transmitter at `tx`, metres; `None` keeps the transmitter
    /// of a scene with `moving_receiver`.
    ///
    /// # Errors
    /// No pose or an invalid one, no transmitter, or several receivers.
    pub fn with_receiver_poses(mut self, poses: Vec<Pose>, tx: Option<[f64; 3]>) -> Result<Self> {
        if self.moving_receiver.is_none() && tx.is_none() {
            return self.refuse("its transmitter moves; add the position of a fixed one with --tx (in Python `tx`)");
        }
        self.moving_receiver = Some(MovingReceiver { turn_deg: 0.0 });
        self.receiver.position = tx.unwrap_or(self.receiver.position);
        self.transmitter.positions = Transmitters::Listed(poses);
        self.checked()
    }

    /// Returns the error `problem` of the scene.
    fn refuse(&self, problem: &str) -> Result<Self> {
        Err(Error::Config(format!("scene `{}`: {problem}", self.name)))
    }

    /// Returns the scene, or an error for its first problem.
    fn checked(self) -> Result<Self> {
        if let Some(problem) = self.first_fault() { self.refuse(&problem) } else { Ok(self) }
    }

    /// Returns the receiver at position `i` of `transmitter`, counted from 0: `position`, metres, with its stated orientation
    /// or at a random angle of `seed`. `None` if the receiver is fixed.
    pub(crate) fn moved_receiver(&self, i: usize, position: DVec3, seed: u64) -> Option<SceneReceiver> {
        let moving = self.moving_receiver.as_ref()?;
        let receiver = SceneReceiver { position: position.to_array(), ..self.receiver.clone() };
        if let Transmitters::Listed(poses) = &self.transmitter.positions {
            let [x, y, z, w] = poses[i].orientation;
            return Some(SceneReceiver { orientation: Orientation::Quaternion(x, y, z, w), ..receiver });
        }
        let share = 2.0 * rng::uniform(&mut rng::stream(seed, "turn", i as u64)) - 1.0;
        let turn = DQuat::from_rotation_z((moving.turn_deg * f64::from(share)).to_radians());
        let [x, y, z, w] = (turn * DQuat::from_array(self.receiver.orientation.quaternion())).normalize().to_array();
        Some(SceneReceiver { orientation: Orientation::Quaternion(x, y, z, w), ..receiver })
    }

    /// Returns the scene at each of its carriers. The name of its receiver contains the carrier, so that noise differs
    /// between carriers. Returns the scene itself if it has no `carriers_hz`.
    pub(crate) fn per_carrier(&self) -> Vec<Self> {
        let at = |hz: &f64| {
            let mut receiver = self.receiver.clone();
            receiver.name = Receiver::new("", Pose::IDENTITY).at_carrier(*hz).name;
            Self { carrier_hz: *hz, carriers_hz: Vec::new(), receiver, ..self.clone() }
        };
        if self.carriers_hz.is_empty() { vec![self.clone()] } else { self.carriers_hz.iter().map(at).collect() }
    }

    /// Returns the scene with only one of its receivers.
    pub fn with_receiver(&self, receiver: &SceneReceiver) -> Self {
        Self { receiver: receiver.clone(), more_receivers: Vec::new(), ..self.clone() }
    }
}
