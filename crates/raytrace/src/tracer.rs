//! Tracer: all paths from a transmitter to a receiver.

use crate::Complex;
use crate::array::{self, Element};
use crate::images::{ImageTree, Orders};
use crate::patches::{Patch, patches};
use crate::path::{Interaction, PropagationPath};
use crate::scattering::amplitude;
use crate::scene::Propagation;
use crate::waves::Ray;
use crate::world::{Edge, World};
use crate::{diffraction, fresnel};
use glam::{DMat3, DVec3};
use std::f64::consts::{PI, TAU};
use std::sync::Arc;

/// Field relative to free space below which a path is dropped.
const NEGLIGIBLE: f64 = 1e-8;
/// Distance from an edge at which its faces are probed, metres.
const BESIDE: f64 = 1e-3;

/// Antenna with pattern and orientation.
#[derive(Clone, Debug)]
pub struct Antenna {
    /// Element pattern.
    pub element: Element,
    /// Polarisation axis in the antenna frame.
    pub axis: DVec3,
    /// Rotation from the antenna frame to the world frame.
    pub world_from_antenna: DMat3,
}

/// Antennas at the ends of a path.
#[derive(Clone, Debug)]
pub struct Antennas {
    /// Antenna of the transmitter.
    pub transmitter: Antenna,
    /// Antenna of the receiver.
    pub receiver: Antenna,
}

impl Antenna {
    /// Returns the field, world frame, radiated towards or received from the unit vector `direction`.
    fn field(&self, direction: DVec3) -> DVec3 {
        let local = self.world_from_antenna.transpose() * direction;
        let (amplitude, polarization) = array::response(&self.element, self.axis, local);
        self.world_from_antenna * polarization * amplitude
    }
}

/// Precomputed data of a receiver, independent of the transmitter.
#[derive(Debug)]
pub struct Tracer {
    world: Arc<World>,
    wavelength: f64,
    transmitter: Antenna,
    receiver: Antenna,
    tree: ImageTree,
    propagation: Propagation,
    /// Patches visible from the receiver.
    patches: Vec<Patch>,
}

impl Tracer {
    /// Creates a tracer for one receiver; `None` if the image tree would grow too large.
    pub fn new(
        world: Arc<World>,
        wavelength: f64,
        Antennas { transmitter, receiver }: Antennas,
        position: DVec3,
        propagation: &Propagation,
    ) -> Option<Self> {
        let orders = Orders { all: propagation.order, room: propagation.room_order };
        let tree = ImageTree::build(&world, position, orders)?;
        let mut sheets = Vec::new();
        let mut patches = patches(&world, propagation.patch_m, propagation.seed);
        patches.retain(|patch| {
            world.collect_sheets(patch.point, position, [&[patch.face], &[]], &mut sheets)
                && (propagation.transmission || sheets.is_empty())
        });
        Some(Self { world, wavelength, transmitter, receiver, tree, propagation: propagation.clone(), patches })
    }

    /// Returns the approximate memory use, bytes.
    pub fn bytes(&self) -> usize {
        self.tree.bytes() + self.patches.len() * size_of::<Patch>()
    }

    /// Returns all paths from `tx`: specular by image order, then diffracted, then scattered.
    pub fn trace(&self, tx: DVec3) -> Vec<PropagationPath> {
        let mut walk =
            TraceWalk { tracer: self, tx, rx: self.tree.origin(), sheets: Vec::new(), interactions: Vec::new() };
        let mut paths = Vec::new();
        self.tree.candidates(&self.world, tx, |faces, points| paths.extend(walk.specular(faces, points)));
        if self.propagation.diffraction {
            paths.extend(self.world.edges.iter().enumerate().filter_map(|(i, edge)| walk.diffracted(i as u32, edge)));
        }
        paths.extend(self.patches.iter().filter_map(|patch| walk.scattered(patch)));
        paths
    }

    /// Returns the amplitude between isotropic antennas at 1 m, λ/4π.
    fn unit_gain(&self) -> f64 {
        self.wavelength / (4.0 * PI)
    }
}

/// Traversal of the candidates of one transmitter, with reused buffers.
struct TraceWalk<'a> {
    tracer: &'a Tracer,
    tx: DVec3,
    rx: DVec3,
    sheets: Vec<(f64, u32)>,
    interactions: Vec<Interaction>,
}

impl TraceWalk<'_> {
    /// Returns the ray after the straight segment from `from` to `to` through sheets. Each end has the faces that it
    /// lies on; `None` if it is blocked.
    fn propagate(
        &mut self,
        ray: Ray,
        (from, start_faces): (DVec3, &[u32]),
        (to, end_faces): (DVec3, &[u32]),
    ) -> Option<Ray> {
        let Self { tracer, sheets, interactions, .. } = self;
        if !tracer.world.collect_sheets(from, to, [start_faces, end_faces], sheets)
            || !(tracer.propagation.transmission || sheets.is_empty())
        {
            return None;
        }
        let through = |ray: Ray, &(at, face): &(f64, u32)| {
            interactions.push(Interaction::Transmission { face, point: from.lerp(to, at) });
            let normal = tracer.world.faces[face as usize].normal;
            ray.transmitted(tracer.world.surface_of(face), normal, tracer.wavelength)
        };
        let ray = sheets.iter().try_fold(ray, through)?;
        (ray.power() > NEGLIGIBLE * NEGLIGIBLE).then_some(ray)
    }

    /// Returns the ray that leaves the transmitter towards `to`.
    fn emit_ray(&mut self, to: DVec3) -> Option<Ray> {
        self.interactions.clear();
        let direction = (to - self.tx).try_normalize()?;
        Some(Ray::new(direction, self.tracer.transmitter.field(direction)))
    }

    /// Returns the path that ends with `ray`; `gain` is its spreading factor.
    fn finish_path(&self, ray: Ray, gain: f64, departure: DVec3, (source, before): (DVec3, f64)) -> PropagationPath {
        let arrival = -ray.direction;
        let field = self.tracer.receiver.field(arrival);
        PropagationPath {
            gain: gain * ray.along(field),
            length: before + self.rx.distance(source),
            departure,
            arrival,
            source,
            before,
            interactions: self.interactions.clone(),
        }
    }

    /// Returns the path that reflects at `points` on `faces`; `None` if it is blocked.
    fn specular(&mut self, faces: &[u32], points: &[DVec3]) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let first = points.first().copied().unwrap_or(self.rx);
        let mut ray = self.emit_ray(first)?;
        let (departure, mut from, mut source) = (ray.direction, self.tx, self.tx);
        let mut start_faces: &[u32] = &[];
        for (on, &point) in faces.chunks(1).zip(points) {
            let face = on[0];
            if tracer.world.front_face(face, point, from) != face {
                return None;
            }
            ray = self.propagate(ray, (from, start_faces), (point, on))?;
            let plane = &tracer.world.faces[face as usize];
            self.interactions.push(Interaction::Reflection { face, point });
            ray = ray.reflected(tracer.world.surface_of(face), plane.normal, tracer.wavelength);
            (from, start_faces, source) = (point, on, plane.mirror(source));
        }
        ray = self.propagate(ray, (from, start_faces), (self.rx, &[]))?;
        if ray.power() <= NEGLIGIBLE * NEGLIGIBLE {
            return None;
        }
        let gain = tracer.unit_gain() / self.rx.distance(source);
        Some(self.finish_path(ray, gain, departure, (source, 0.0)))
    }

    /// Returns the path that diffracts at `edge`; `None` if it is blocked or misses the edge.
    fn diffracted(&mut self, index: u32, edge: &Edge) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let [a, b] = edge.ends;
        let t = diffraction::edge_point(a, b, self.tx, self.rx);
        if !(t > 0.0 && t < 1.0) {
            return None;
        }
        let point = a.lerp(b, t);
        let wedge = self.wedge(edge, point)?;
        let ray = self.emit_ray(point)?;
        let departure = ray.direction;
        let ray = self.propagate(ray, (self.tx, &[]), (point, &edge.faces))?;
        self.interactions.push(Interaction::Diffraction { edge: index, point });
        let out = (self.rx - point).try_normalize()?;
        let ray = ray.diffracted((b - a).normalize(), out, &wedge);
        let ray = self.propagate(ray, (point, &edge.faces), (self.rx, &[]))?;
        let (before, after) = (self.tx.distance(point), self.rx.distance(point));
        let gain = tracer.unit_gain() / (before * after * (before + after)).sqrt();
        Some(self.finish_path(ray, gain, departure, (point, before)))
    }

    /// Returns the diffraction coefficients at a point of an edge; `None` if transmitter or receiver is inside the
    /// wedge or on the line of the edge.
    fn wedge(&self, edge: &Edge, point: DVec3) -> Option<fresnel::Polarized> {
        let Tracer { world, wavelength, .. } = self.tracer;
        let direction = (edge.ends[1] - edge.ends[0]).normalize();
        let angle = |to: DVec3| {
            let angle = to.dot(edge.normal).atan2(to.dot(edge.along));
            if angle < 0.0 { angle + TAU } else { angle }
        };
        let (to_tx, to_rx) = (self.tx - point, self.rx - point);
        let (phi_in, phi_out) = (angle(to_tx), angle(to_rx));
        let sine = direction.cross(to_tx).length() / to_tx.length();
        let whole = edge.outer_angle * PI;
        if phi_in >= whole || phi_out >= whole || sine < 1e-6 {
            return None;
        }
        // The smaller of the two angles on either face: exact at reflection boundaries and reciprocal (El-Sallabi and
        // Vainikainen, 2005).
        let inwards = edge.inwards();
        let at = |k: usize, grazing: f64| {
            let face = edge.faces[k];
            // Face that covers the one next to the edge, if any.
            let front = world.front_face(face, point + BESIDE * inwards[k], self.tx);
            let cosine = (grazing.sin() * sine).abs();
            let through = |face: u32| {
                let surface = world.surface_of(face);
                let slab = |d| fresnel::transmission(surface.eta, d, cosine, *wavelength);
                surface.thickness.map_or(fresnel::Polarized::NOTHING, slab)
            };
            let surface = world.surface_of(front);
            let reflected = fresnel::reflection(surface.eta, surface.thickness, cosine, *wavelength);
            let alone = through(face);
            (reflected, if front == face { alone } else { alone.times(through(front)) })
        };
        let (r0, t0) = at(0, phi_in.min(phi_out));
        let (rn, tn) = at(1, whole - phi_in.max(phi_out));
        // The rim of a sheet has one sheet behind it, an edge of two faces has both.
        let is_rim = edge.faces[0] == edge.faces[1];
        let through = if is_rim { t0 } else { t0.times(tn) };
        let distances = (to_tx.length(), to_rx.length());
        let (k, angles, sides) = (TAU / wavelength, (phi_in, phi_out), diffraction::Sides { r0, rn, through });
        Some(diffraction::wedge(edge.outer_angle, k, distances, angles, sine, &sides))
    }

    /// Returns the path that scatters at `patch`; `None` if it is blocked.
    fn scattered(&mut self, patch: &Patch) -> Option<PropagationPath> {
        let tracer = self.tracer;
        let surface = tracer.world.surface_of(patch.face);
        let normal = tracer.world.faces[patch.face as usize].normal;
        let (to_tx, to_rx) = (self.tx - patch.point, self.rx - patch.point);
        let out = to_rx.try_normalize()?;
        let ray = self.emit_ray(patch.point)?;
        let (departure, cos_in, cos_out) = (ray.direction, -ray.direction.dot(normal), out.dot(normal));
        if cos_in * cos_out <= 0.0 {
            return None; // it scatters back to the side that the wave came from
        }
        if tracer.world.front_face(patch.face, patch.point, self.tx) != patch.face {
            return None;
        }
        let ray = self.propagate(ray, (self.tx, &[]), (patch.point, &[patch.face]))?;
        let r = fresnel::reflection(surface.eta, surface.thickness, cos_in.abs(), tracer.wavelength);
        let reflected = (0.5 * (r.te.norm_sqr() + r.tm.norm_sqr())).sqrt();
        let specular = departure - 2.0 * departure.dot(normal) * normal;
        let density = surface.lobe.density(cos_in.abs(), cos_out.abs(), specular.dot(out));
        let (before, after) = (to_tx.length(), to_rx.length());
        // Within its own size a patch is not a point source: its field is clamped.
        let size = (patch.area / PI).sqrt();
        let distances = (before.max(size), after.max(size));
        let (area, wavelength, roughness) = (patch.area, tracer.wavelength, surface.roughness);
        let gain = amplitude(roughness, reflected, density, area, cos_in.abs(), distances, wavelength);
        self.interactions.push(Interaction::Scattering { face: patch.face, point: patch.point });
        let ray = ray.scattered(out, Complex::cis(patch.phase));
        let ray = self.propagate(ray, (patch.point, &[patch.face]), (self.rx, &[]))?;
        Some(self.finish_path(ray, gain, departure, (patch.point, before)))
    }
}
