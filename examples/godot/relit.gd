## A model of `slepian-prt export`, loaded while the game runs, and relit by a map that may turn.
##
## Godot has to keep `_CUSTOM0` to `_CUSTOM3` of glTF, as it does from mid-2026 on (pull request 120040).
class_name Relit
extends Node3D

@export_file("*.glb") var model := "res://model.glb"
@export_file("*.hdr") var map := "res://map.hdr"
@export_file("*.gdshader") var shader := "res://relit.gdshader"

## By which the map is turned about y, counter-clockwise seen from above.
@export_range(0.0, 360.0) var degrees := 0.0:
	set(value):
		degrees = value
		if is_node_ready():
			relight()

const MAP_SIZE := Vector2i(64, 32)

var told: Dictionary
var functions: PackedFloat32Array
var zeros: PackedFloat32Array
var meshes: Array[MeshInstance3D] = []
var light_map: Image
var table: ImageTexture


func _ready() -> void:
	var document := GLTFDocument.new()
	var state := GLTFState.new()
	if document.append_from_file(model, state) != OK:
		push_error("%s: cannot be read" % model)
		return
	told = state.json.get("extras", {}).get("slepian_prt", {})
	if told.get("kind") != "transfer" or told["bytesPerVertex"] != 16 or told["coefficients"]["in"] == "texture":
		push_error("%s: is no model of `slepian-prt export` with 16 functions" % model)
		return
	functions = _numbers(state, told["functions"])
	zeros = _numbers(state, told["zeros"])
	light_map = Image.load_from_file(map)
	light_map.convert(Image.FORMAT_RGBF)
	light_map.resize(MAP_SIZE.x, MAP_SIZE.y, Image.INTERPOLATE_TRILINEAR)
	var scene := document.generate_scene(state)
	add_child(scene)
	_relit_materials(scene)
	relight()


## Make the table anew for the light as it is now.
func relight() -> void:
	var size: int = (int(told["bandlimit"]) + 1) ** 2
	var channels: int = told["channels"]
	var caps: int = told["caps"]
	var light := _light()
	var image := Image.create_empty(16, caps, false, Image.FORMAT_RGBAF)
	for cap in caps:
		var mean := Vector3.ZERO
		for k in range(15, -1, -1):
			var sum := Vector3.ZERO
			for c in 3:
				var first := ((cap * 16 + k) * channels + (c if channels == 3 else 0)) * size
				var product := 0.0
				for i in size:
					product += functions[first + i] * light[c * size + i]
				sum[c] = product
			if k > 0:
				mean -= zeros[cap * 15 + k - 1] * sum
			else:
				sum += mean
			image.set_pixel(k, cap, Color(sum.x, sum.y, sum.z))
	if table == null:
		table = ImageTexture.create_from_image(image)
	else:
		table.update(image)
	for mesh in meshes:
		for surface in mesh.mesh.get_surface_count():
			(mesh.get_surface_override_material(surface) as ShaderMaterial).set_shader_parameter("table", table)


## Coefficients of the map, red, then green, then blue, in the axes of the model.
func _light() -> PackedFloat64Array:
	var bandlimit: int = told["bandlimit"]
	var size := (bandlimit + 1) ** 2
	var light := PackedFloat64Array()
	light.resize(3 * size)
	var to_model := meshes[0].global_basis.orthonormalized().inverse() * Basis(Vector3.UP, deg_to_rad(degrees))
	for row in MAP_SIZE.y:
		var theta := PI * (row + 0.5) / MAP_SIZE.y
		var step := PI / MAP_SIZE.y
		var area := (cos(theta - step / 2.0) - cos(theta + step / 2.0)) * TAU / MAP_SIZE.x
		for column in MAP_SIZE.x:
			var phi := TAU * (column + 0.5) / MAP_SIZE.x
			var toward := to_model * Vector3(sin(theta) * sin(phi), cos(theta), -sin(theta) * cos(phi))
			var values := harmonics(bandlimit, toward)
			var color := light_map.get_pixel(column, row)
			for c in 3:
				for i in size:
					light[c * size + i] += area * color[c] * values[i]
	return light


## Real spherical harmonics of a unit vector: orthonormal, Condon–Shortley phase, polar axis z, index l² + l + m.
static func harmonics(bandlimit: int, d: Vector3) -> PackedFloat64Array:
	var values := PackedFloat64Array()
	values.resize((bandlimit + 1) ** 2)
	var cosine := 1.0
	var sine := 0.0
	var start := sqrt(1.0 / (4.0 * PI))
	for m in bandlimit + 1:
		if m > 0:
			var turned := cosine * d.x - sine * d.y
			sine = cosine * d.y + sine * d.x
			cosine = turned
			start *= -sqrt((2.0 * m + 1.0) / (2.0 * m) * (2.0 if m == 1 else 1.0))
		var before := 0.0
		var now := start
		for l in range(m, bandlimit + 1):
			values[l * l + l - m] = now * sine
			values[l * l + l + m] = now * cosine
			var a := sqrt((4.0 * (l + 1) ** 2 - 1.0) / ((l + 1) ** 2 - m * m))
			var b := sqrt((l * l - m * m) / (4.0 * l * l - 1.0)) if l > m else 0.0
			var next := a * (d.z * now - b * before)
			before = now
			now = next
	return values


## Give all surfaces the shader, with the texture and colour that they had.
func _relit_materials(node: Node) -> void:
	if node is MeshInstance3D:
		meshes.append(node)
		for surface in node.mesh.get_surface_count():
			var given := node.mesh.surface_get_material(surface) as BaseMaterial3D
			var material := ShaderMaterial.new()
			material.shader = load(shader)
			if given.albedo_texture != null:
				material.set_shader_parameter("image", given.albedo_texture)
			var color := given.albedo_color.srgb_to_linear()
			material.set_shader_parameter("base_color", Vector3(color.r, color.g, color.b))
			node.set_surface_override_material(surface, material)
	for child in node.get_children():
		_relit_materials(child)


## An array that `extras` tell of, as floats.
func _numbers(state: GLTFState, entry: Dictionary) -> PackedFloat32Array:
	var view: Dictionary = state.json["bufferViews"][int(entry["bufferView"])]
	var first := int(view.get("byteOffset", 0))
	var bytes := state.glb_data.slice(first, first + int(view["byteLength"]))
	if entry["dtype"] == "float32":
		return bytes.to_float32_array()
	var numbers := PackedFloat32Array()
	numbers.resize(bytes.size() / 2)
	for i in numbers.size():
		numbers[i] = bytes.decode_half(2 * i)
	return numbers
