# graphtrack serve on port 8765; streams are kept in the volume /streams.
FROM python:3.12-slim
RUN useradd --create-home graphtrack && mkdir /streams && chown graphtrack /streams
COPY . /src
RUN pip install --no-cache-dir --constraint /src/constraints.txt '/src[serve]' && rm -rf /src
USER graphtrack
# What the streams run is compiled once, here.
RUN graphtrack warm-up
VOLUME /streams
EXPOSE 8765
HEALTHCHECK CMD python -c "import urllib.request as r; r.urlopen('http://127.0.0.1:8765/ready')"
# It listens on all of the container's interfaces, so a token is required: docker run -e GRAPHTRACK_TOKEN=…;
# clients on other machines: docker run … graphtrack --allow-host NAME.
ENTRYPOINT ["graphtrack", "serve", "--host", "0.0.0.0", "--state", "/streams"]
