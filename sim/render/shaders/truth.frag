#version 330 core

flat in float v_instance;
out vec2 truth;

void main()
{
    truth = vec2(1.0 / gl_FragCoord.w, v_instance);    // z in the camera frame [m], instance
}
