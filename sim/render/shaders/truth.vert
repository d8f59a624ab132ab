#version 330 core

layout(location = 0) in vec3 position;
layout(location = 4) in mat4 model;
layout(location = 8) in float instance;
uniform mat4 camera;
flat out float v_instance;

void main()
{
    gl_Position = camera * (model * vec4(position, 1.0));
    v_instance = instance;
}
