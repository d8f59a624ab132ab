#version 330 core

layout(location = 0) in vec3 position;
layout(location = 4) in mat4 model;
uniform mat4 camera;

void main()
{
    gl_Position = camera * (model * vec4(position, 1.0));
}
