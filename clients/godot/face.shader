// A face whose vertices lie in textures as the stream sends them: 16 bits fixed point, the low byte in r, the high one in g,
// three texels a vertex; or rebuilt by the script, one texel of floats a vertex. VERTEX.x is the vertex's number.
shader_type spatial;
// The stream's triangles are counter-clockwise from outside, Godot's front faces are clockwise; of those that are not front
// faces it turns the normals round, so that they go in turned round too.
render_mode cull_front;

uniform sampler2D positions;
uniform sampler2D normals;
uniform sampler2D albedo_texels;
uniform bool rebuilt = false;
uniform bool has_albedo = false;
uniform float step_mm = 0.0;
uniform float albedo_scale = 1.0;
uniform vec4 clay : hint_color = vec4(0.72, 0.48, 0.38, 1.0);
const int VERTICES_A_ROW = 512;

varying vec3 linear_albedo;

vec3 unsigned_of(sampler2D texels, ivec2 at) {
	vec2 x = texelFetch(texels, at, 0).rg;
	vec2 y = texelFetch(texels, at + ivec2(1, 0), 0).rg;
	vec2 z = texelFetch(texels, at + ivec2(2, 0), 0).rg;
	return floor(vec3(x.r, y.r, z.r) * 255.0 + 0.5) + 256.0 * floor(vec3(x.g, y.g, z.g) * 255.0 + 0.5);
}

vec3 signed_of(sampler2D texels, ivec2 at) {
	vec3 value = unsigned_of(texels, at);
	return value - 65536.0 * step(vec3(32768.0), value);
}

void vertex() {
	int number = int(VERTEX.x + 0.5);
	ivec2 place = ivec2(number % VERTICES_A_ROW, number / VERTICES_A_ROW);
	ivec2 first = ivec2(3 * place.x, place.y);
	if (rebuilt) {
		VERTEX = 0.001 * texelFetch(positions, place, 0).xyz;
		NORMAL = -texelFetch(normals, place, 0).xyz;
	} else {
		VERTEX = 0.001 * step_mm * signed_of(positions, first);
		NORMAL = -normalize(signed_of(normals, first));
	}
	linear_albedo = has_albedo ? albedo_scale / 65535.0 * unsigned_of(albedo_texels, first) : clay.rgb;
}

void fragment() {
	ALBEDO = linear_albedo;
	ROUGHNESS = 0.55;
	SPECULAR = 0.35;
}
