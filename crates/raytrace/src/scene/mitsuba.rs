//! Scenes of Mitsuba 3 and Sionna RT: an XML file with meshes and radio materials.

mod limits;

use super::room::{Finish, Object};
use crate::material::{self, Material};
use crate::mesh::MOST_TRIANGLES;
use glam::{DAffine3, DMat4, DVec3};
use limits::{LONGEST, check_tags, expand};
use pwrfgs_core::messages::{quoted, strip_control};
use pwrfgs_core::{Error, Result, did_you_mean, files};
use roxmltree::{Document, Node};
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::Path;

/// Largest XML file, bytes.
const MOST_BYTES: u64 = 8 << 20;
/// Largest number of shapes; each is a file.
const MOST_SHAPES: usize = 5_000;
/// Largest number of variables.
const MOST_VARIABLES: usize = 100;
/// Thickness of a material that states none, as in Sionna RT, metres.
const THICKNESS: f64 = 0.1;
/// Properties of radio materials in Sionna RT, the last three of scattering patterns.
const PROPERTIES: [&str; 11] = [
    "type",
    "relative_permittivity",
    "conductivity",
    "thickness",
    "scattering_coefficient",
    "xpd_coefficient",
    "scattering_pattern",
    "color",
    "alpha_r",
    "alpha_i",
    "lambda_",
];
/// Shapes, and elements that describe a picture.
const KNOWN: [&str; 9] =
    ["shape", "integrator", "sensor", "emitter", "film", "sampler", "rfilter", "texture", "medium"];

/// Contents of a Mitsuba file.
#[derive(Debug, Default)]
pub(crate) struct MitsubaScene {
    /// One mesh per shape.
    pub(crate) objects: Vec<Object>,
    /// Materials of type `radio-material`, by id.
    pub(crate) materials: BTreeMap<String, Material>,
}

impl MitsubaScene {
    /// Reads the shapes and radio materials of an XML file; paths of meshes become relative to the current directory.
    ///
    /// # Errors
    /// Reports line and column of an error: syntax, an element or material that is not supported, a missing mesh.
    pub(crate) fn read(path: &Path) -> Result<Self> {
        let text = files::read_text_at_most(path, MOST_BYTES)?;
        check_tags(path, &text)?;
        let document = Document::parse(&text).map_err(|e| {
            let (row, column) = (e.pos().row as usize, e.pos().col as usize);
            Error::at(
                path,
                row,
                column,
                format!("invalid XML: {}; export the scene again", strip_control(&e.to_string())),
            )
        })?;
        let mut reader = Reader { path, document: &document, variables: BTreeMap::new(), finishes: BTreeMap::new() };
        reader.scene()
    }

    /// Returns the default antennas: receiver position, and smallest and largest transmitter position.
    ///
    /// # Errors
    /// A mesh that cannot be read.
    pub(crate) fn antennas(&self) -> Result<[[f64; 3]; 3]> {
        let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        let mut triangles = 0;
        for object in &self.objects {
            let mesh = object.placed_mesh(false)?;
            triangles += mesh.triangles.len();
            if triangles > MOST_TRIANGLES {
                let advice = "triangles, a mesh counted once per shape; simplify the meshes";
                return Err(Error::Config(format!("the shapes have more than {MOST_TRIANGLES} {advice}")));
            }
            for vertex in mesh.vertices {
                (low, high) = (low.min(vertex), high.max(vertex));
            }
        }
        if (high.x - low.x).min(high.y - low.y) < 1e-6 {
            let problem = "a single wall has no default antennas; name the XML file in a scene file, as `mitsuba`";
            return Err(Error::Config(problem.into()));
        }
        // Heights of people, or the middle of anything lower; multiples of 0.1 mm, as transmitters are.
        let height = if high.z - low.z > 0.01 { (0.5 * (high.z - low.z)).min(1.5) } else { 1.5 };
        let round = |point: DVec3| point.to_array().map(|v| (v * 1e4).round() / 1e4);
        let middle = (0.5 * (low + high)).with_z(low.z + height);
        let reach = 0.4 * (high - low).with_z(0.0);
        Ok([middle, middle - reach, middle + reach].map(round))
    }
}

/// State of the parser.
struct Reader<'a> {
    path: &'a Path,
    document: &'a Document<'a>,
    /// Values of `<default>`, inserted for `$name`.
    variables: BTreeMap<&'a str, &'a str>,
    /// Materials so far, by id.
    finishes: BTreeMap<String, Finish>,
}

type Element<'a> = Node<'a, 'a>;

/// Returns the child elements.
fn elements(node: Element<'_>) -> impl Iterator<Item = Element<'_>> {
    node.children().filter(Node::is_element)
}

/// Returns the child element with the given `name` attribute.
fn property<'a>(node: Element<'a>, name: &str) -> Option<Element<'a>> {
    elements(node).find(|child| child.attribute("name") == Some(name))
}

impl<'a> Reader<'a> {
    /// Returns the error `problem` at an element.
    fn fault(&self, node: Element<'_>, problem: impl Display) -> Error {
        let pos = self.document.text_pos_at(node.range().start);
        Error::at(self.path, pos.row as usize, pos.col as usize, problem)
    }

    /// Returns the error `problem` at `node` unless `holds`.
    fn require(&self, holds: bool, node: Element<'_>, problem: impl Display) -> Result<()> {
        if holds { Ok(()) } else { Err(self.fault(node, problem)) }
    }

    /// Reads the whole scene.
    fn scene(&mut self) -> Result<MitsubaScene> {
        let root = self.document.root_element();
        let problem = "this is not a Mitsuba scene; give a file whose first element is `scene`";
        self.require(root.has_tag_name("scene"), root, problem)?;
        let mut scene = MitsubaScene::default();
        for node in elements(root) {
            match node.tag_name().name() {
                "default" => self.define(node)?,
                "bsdf" => drop(self.material(node, &mut scene)?),
                name => {
                    let problem = "put its shapes and materials into this file";
                    let problem = format!("unsupported element {}; {problem}", quoted(name));
                    self.require(KNOWN.contains(&name), node, problem)?;
                }
            }
        }
        for node in elements(root).filter(|node| node.has_tag_name("shape")) {
            let problem = "shapes; join the meshes of each material, or cut out a part";
            self.require(scene.objects.len() < MOST_SHAPES, node, format_args!("more than {MOST_SHAPES} {problem}"))?;
            let object = self.shape(node, &mut scene)?;
            scene.objects.push(object);
        }
        self.require(!scene.objects.is_empty(), root, "the scene has no `shape`; export its meshes too")?;
        Ok(scene)
    }

    /// Reads the variable of a `default` element.
    fn define(&mut self, node: Element<'a>) -> Result<()> {
        let pair = node.attribute("name").zip(node.attribute("value"));
        let pair = pair.filter(|(name, value)| !name.is_empty() && !value.contains('$') && value.len() <= LONGEST);
        let problem = "`default` needs a `name` and a short `value` without `$`; correct it, and give at most 100";
        self.require(pair.is_some() && self.variables.len() < MOST_VARIABLES, node, problem)?;
        self.variables.extend(pair);
        Ok(())
    }

    /// Returns the value of an attribute with variables replaced.
    fn attribute(&self, node: Element<'_>, name: &str) -> Result<Option<String>> {
        let Some(value) = node.attribute(name) else { return Ok(None) };
        expand(name, value, &self.variables).map(Some).map_err(|problem| self.fault(node, problem))
    }

    /// Returns the value of a required attribute.
    fn required(&self, node: Element<'_>, name: &str) -> Result<String> {
        let missing = || self.fault(node, format!("the element has no `{name}`; add it"));
        self.attribute(node, name)?.ok_or_else(missing)
    }

    /// Returns the numbers of an attribute, separated by commas or blanks.
    fn numbers(&self, node: Element<'_>, name: &str) -> Result<Option<Vec<f64>>> {
        let Some(text) = self.attribute(node, name)? else { return Ok(None) };
        let fields = text.split([',', ' ', '\t', '\n']).filter(|field| !field.is_empty());
        let number = |field: &str| field.parse::<f64>().ok().filter(|v| v.is_finite());
        let fault = |field| self.fault(node, format!("`{name}`: {} is not a finite number; correct it", quoted(field)));
        fields.map(|field| number(field).ok_or_else(|| fault(field))).collect::<Result<Vec<f64>>>().map(Some)
    }

    /// Returns one number of an attribute.
    fn number(&self, node: Element<'_>, name: &str) -> Result<Option<f64>> {
        match self.numbers(node, name)?.as_deref() {
            None => Ok(None),
            Some(&[value]) => Ok(Some(value)),
            Some(_) => Err(self.fault(node, format!("`{name}` must be one number; correct it"))),
        }
    }

    /// Returns the number of a property from `low` to `high`, if it is present.
    fn value(&self, node: Element<'_>, name: &str, low: f64, high: f64) -> Result<Option<f64>> {
        let Some(child) = property(node, name) else { return Ok(None) };
        let value = self.number(child, "value")?.filter(|value| (low..=high).contains(value));
        let fault = || self.fault(child, format!("`{name}` must be a number from {low} to {high}; correct it"));
        value.ok_or_else(fault).map(Some)
    }

    /// Checks the names of the properties of a radio material of Sionna RT, and that none is a texture.
    fn check_properties(&self, node: Element<'_>) -> Result<()> {
        for child in elements(node) {
            let problem = "unsupported texture: a radio material is constant over a mesh; split the mesh by material";
            self.require(!child.has_tag_name("texture"), child, problem)?;
            let name = self.required(child, "name")?;
            if !PROPERTIES.contains(&&*name) {
                let hint = did_you_mean(&name, PROPERTIES);
                let problem =
                    format!("unknown property {}{hint} of a radio material; correct or remove it", quoted(&name));
                return Err(self.fault(child, problem));
            }
        }
        Ok(())
    }

    /// Reads a radio material.
    fn material(&mut self, node: Element<'_>, scene: &mut MitsubaScene) -> Result<Finish> {
        let unnamed = || format!("material {}", self.finishes.len() + 1);
        let (id, kind) = (self.attribute(node, "id")?.unwrap_or_else(unnamed), self.required(node, "type")?);
        let (itu_names, shown) = (material::names(), quoted(&id));
        let plain = id.strip_prefix("mat-").unwrap_or(&id);
        let itu = plain.strip_prefix("itu_").or_else(|| plain.strip_prefix("itu-"));
        let itu = itu.filter(|_| kind != "radio-material"); // which states its own constants
        if ["radio-material", "itu-radio-material"].contains(&&*kind) {
            self.check_properties(node)?;
        }
        let material = if kind == "itu-radio-material" || itu.is_some() {
            let type_node = property(node, "type");
            let stated = type_node.map(|child| self.required(child, "value")).transpose()?;
            let name = stated.or(itu.map(str::to_owned)).unwrap_or_default();
            if !itu_names.contains(&&*name) {
                let (hint, all) = (did_you_mean(&name, itu_names.iter().copied()), itu_names.join(", "));
                let problem = format!("unknown ITU material {}{hint}; its `type` is one of {all}", quoted(&name));
                return Err(self.fault(type_node.unwrap_or(node), problem));
            }
            name
        } else {
            let problem = "is not a radio material; rename it to `itu_concrete` or another ITU material, or set its type to \
                        `itu-radio-material`";
            let problem = format!("material {shown} of type {} {problem}", quoted(&kind));
            self.require(kind == "radio-material", node, problem)?;
            let a = self.value(node, "relative_permittivity", 1.0, 1e6)?.unwrap_or(1.0);
            let c = self.value(node, "conductivity", 0.0, 1e12)?.unwrap_or(0.0);
            // A name of ITU-R P.2040 would replace that material in the whole scene.
            let name = if itu_names.contains(&&*id) { format!("{id} (radio-material)") } else { id.clone() };
            scene.materials.insert(name.clone(), Material { a, b: 0.0, c, d: 0.0, range_ghz: (0.0, f64::INFINITY) });
            name
        };
        if self.value(node, "xpd_coefficient", 0.0, 1.0)?.is_some_and(|xpd| xpd > 0.0) {
            tracing::warn!("{}: `xpd_coefficient` of material {shown} is ignored", self.path.display());
        }
        let thickness_m = Some(self.value(node, "thickness", 1e-6, 10.0)?.unwrap_or(THICKNESS));
        let roughness = self.value(node, "scattering_coefficient", 0.0, 1.0)?;
        let finish = Finish { material, thickness_m, roughness };
        let other = self.finishes.insert(id, finish.clone());
        self.require(other.is_none(), node, format_args!("two materials have the id {shown}; rename one of them"))?;
        Ok(finish)
    }

    /// Reads a shape as an object with a mesh.
    fn shape(&mut self, node: Element<'_>, scene: &mut MitsubaScene) -> Result<Object> {
        let kind = quoted(&self.required(node, "type")?);
        let problem = format!("unsupported shape type {kind}; export the shape as a PLY mesh");
        self.require(["`ply`", "`obj`"].contains(&&*kind), node, problem)?;
        let name = self.attribute(node, "id")?.unwrap_or(format!("shape {}", scene.objects.len() + 1));
        let source = property(node, "filename");
        let source = source.ok_or_else(|| self.fault(node, "a shape needs a `filename`; add the path of its mesh"))?;
        let stated = self.required(source, "value")?.replace('\\', "/");
        let file = self.path.parent().unwrap_or(Path::new("")).join(&stated);
        let problem =
            "is missing: paths begin in the folder of the XML file, so copy its meshes too, or correct the path";
        self.require(file.is_file(), source, format_args!("mesh {} {problem}", quoted(&stated)))?;
        let finish = self.finish(node, scene)?;
        let mut matrix = None;
        for transform in elements(node).filter(|child| child.has_tag_name("transform")) {
            self.require(
                transform.attribute("name") == Some("to_world"),
                transform,
                "rename the transform `to_world`",
            )?;
            let [x, y, z, _] = DMat4::from(self.transform(transform)?).transpose().to_cols_array_2d();
            matrix = Some([x, y, z]);
        }
        Ok(Object::Mesh { name, file, matrix, scale: 1.0, yaw_deg: 0.0, shift: [0.0; 3], hollow: true, finish })
    }

    /// Returns the material of a shape: inside it, or referenced.
    fn finish(&mut self, node: Element<'_>, scene: &mut MitsubaScene) -> Result<Finish> {
        if let Some(inner) = elements(node).find(|child| child.has_tag_name("bsdf")) {
            return self.material(inner, scene);
        }
        let is_bsdf = |child: &Element<'_>| child.attribute("name").is_none_or(|name| name == "bsdf");
        let reference = elements(node).filter(is_bsdf).find(|child| child.has_tag_name("ref"));
        let problem = "the shape has no material; add <ref id=\"..\" name=\"bsdf\"/> with the id of a `bsdf`";
        let reference = reference.ok_or_else(|| self.fault(node, problem))?;
        let id = self.required(reference, "id")?;
        self.finishes.get(&id).cloned().ok_or_else(|| {
            let hint = did_you_mean(&id, self.finishes.keys().map(String::as_str));
            self.fault(reference, format!("unknown material {}{hint}; add a `bsdf` with this id", quoted(&id)))
        })
    }

    /// Reads a `transform` element: its steps in order.
    fn transform(&self, node: Element<'_>) -> Result<DAffine3> {
        let mut all = DAffine3::IDENTITY;
        for step in elements(node) {
            let fault = |problem: &str| self.fault(step, problem);
            let next = match step.tag_name().name() {
                "translate" => DAffine3::from_translation(self.vector(step, 0.0)?),
                "scale" => DAffine3::from_scale(self.vector(step, 1.0)?),
                "rotate" => {
                    let (axis, angle) = (self.vector(step, 0.0)?.try_normalize(), self.number(step, "angle")?);
                    let Some((axis, degrees)) = axis.zip(angle) else {
                        return Err(fault("`rotate` needs an axis x, y or z, and an `angle` in degrees"));
                    };
                    DAffine3::from_axis_angle(axis, degrees.to_radians())
                }
                "matrix" => match self.numbers(step, "value")?.as_deref() {
                    Some(rows @ [.., 0.0, 0.0, 0.0, 1.0]) if rows.len() == 16 => {
                        DAffine3::from_mat4(DMat4::from_cols_slice(rows).transpose())
                    }
                    _ => return Err(fault("`matrix` needs 16 numbers, row by row, the last row 0 0 0 1")),
                },
                _ => return Err(fault("unsupported transform; use translate, scale, rotate or matrix")),
            };
            all = next * all;
        }
        Ok(all)
    }

    /// Returns the vector from `value`, with one or three numbers, or from `x`, `y` and `z`.
    fn vector(&self, node: Element<'_>, default: f64) -> Result<DVec3> {
        match self.numbers(node, "value")?.as_deref() {
            Some(&[all]) => Ok(DVec3::splat(all)),
            Some(&[x, y, z]) => Ok(DVec3::new(x, y, z)),
            Some(_) => Err(self.fault(node, "`value` needs one number or three")),
            None => {
                let axis = |name| Ok(self.number(node, name)?.unwrap_or(default));
                Ok(DVec3::new(axis("x")?, axis("y")?, axis("z")?))
            }
        }
    }
}
