"""The GL programs that draw a model: distance and light of the surface at the centre of each pixel."""

from typing import Any

from pipeline.synth.render_and_paste.lights import MOST_LAMPS

BRIGHTEST = 4.0
"""Linear light that fills the 16 bits of a channel; 1 is white."""

_VERTEX = """
layout(location = 0) in vec3 position;
layout(location = 1) in vec3 normal;
layout(location = 2) in vec3 color;
layout(location = 3) in vec2 uv;
uniform mat4 clip_from_camera;
uniform mat4 camera_from_model;
uniform mat3 normal_camera_from_model;
out vec3 surface_normal;
#ifdef TEXTURED
out vec2 texture_uv;
#else
out vec3 base_color;
#endif
void main() {
    vec4 in_camera = camera_from_model * vec4(position, 1.0);
    surface_normal = normal_camera_from_model * normal;
#ifdef TEXTURED
    texture_uv = uv;
#else
    base_color = color;
#endif
    gl_Position = clip_from_camera * in_camera;
}
"""

# Highlights are Schlick's rational function in place of a power, and light is written linear: both for speed on a CPU,
# where the program runs several times per pixel, as triangles are small.
_FRAGMENT = """
in vec3 surface_normal;
#ifdef TEXTURED
in vec2 texture_uv;
uniform sampler2D picture;
#else
in vec3 base_color;
#endif
uniform vec4 plain;  // a colour for the whole model where w is 1
uniform vec3 up;
uniform vec3 from_above;
uniform vec3 from_below;
uniform int lamps;
uniform vec3 lamp_directions[MOST_LAMPS];
uniform vec3 lamp_colors[MOST_LAMPS];
uniform float gloss;
uniform float sharpness;
uniform vec4 ray_of_pixel;  // x and y of the ray at depth 1 through a pixel: factors, then offsets
layout(location = 0) out vec4 light;
void main() {
    vec3 normal = normalize(surface_normal);
    vec3 to_camera = -normalize(vec3(gl_FragCoord.xy * ray_of_pixel.xy + ray_of_pixel.zw, 1.0));
    if (dot(normal, to_camera) < 0.0) normal = -normal;  // meshes have faces that are turned inside out
#ifdef TEXTURED
    vec3 base = mix(texture(picture, texture_uv).rgb, plain.rgb, plain.w);
#else
    vec3 base = mix(base_color, plain.rgb, plain.w);
#endif
    vec3 sum = base * mix(from_below, from_above, 0.5 + 0.5 * dot(normal, up));
    for (int i = 0; i < lamps; i++) {
        float facing = dot(normal, lamp_directions[i]);
        float t = max(dot(normal, normalize(lamp_directions[i] + to_camera)), 0.0);
        float highlight = facing > 0.0 ? gloss * t / (sharpness - sharpness * t + t) : 0.0;
        sum += lamp_colors[i] * (base * max(facing, 0.0) + highlight);
    }
    light = vec4(sum / BRIGHTEST, 1.0);
}
"""


def compile_program(gl: Any, textured: bool) -> Any:
    """Compile the program for models with or without a texture, in the current context."""
    from OpenGL.GL.shaders import compileProgram, compileShader

    defines = f"#version 330 core\n#define MOST_LAMPS {MOST_LAMPS}\n#define BRIGHTEST {BRIGHTEST}\n"
    defines += "#define TEXTURED\n" if textured else ""
    shaders = [
        compileShader(defines + _VERTEX, gl.GL_VERTEX_SHADER),
        compileShader(defines + _FRAGMENT, gl.GL_FRAGMENT_SHADER),
    ]
    return compileProgram(*shaders, validate=False)
