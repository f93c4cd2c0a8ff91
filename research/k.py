import json,sys; sys.path.insert(0,"/tmp/e60")
from exp1 import *
ks=[]
for l in open(sys.argv[1]):
    r=json.loads(l); s=random_scan(r["seed"],48,CACHE); A=s.A; g=A.geometry
    e=np.array([q["e"] for q in r["rows"]]); err=np.array([q["err"] for q in r["rows"]]); i=err.argmin()
    # parabola in log err
    eb=float(e[i])
    if 0<i<len(e)-1:
        y=np.log(err[i-1:i+2]); eb+= -0.5*( (y[2]-y[0]) )/((y[0]-2*y[1]+y[2]))*(e[i+1]-e[i])
    mag=np.linalg.norm(g.source,axis=1).mean()/np.linalg.norm(g.detector-g.source,axis=1).mean()
    q=g.panel.pitch_u*mag
    w=1/(noise_var(s.p,s.photons)+np.float32(r["m2"]))
    seen=s.p>0.02*np.percentile(s.p,99)
    wb=float(w[seen].mean()); wh=float(1/np.mean(1/w[seen]))
    beta=10*2**eb/s.mu
    k1=beta*q/np.sqrt(len(A)*wb); k2=beta*q/np.sqrt(len(A)*wh)
    ks.append((k1,k2)); print(r["seed"],r["family"],len(A),"nv/m2 %.2f"%(r["nv"]/r["m2"]),"eb %.2f k1 %.2f k2 %.2f"%(eb,k1,k2))
ks=np.log2(np.array(ks)); print("log2 median",np.median(ks,0),"std",ks.std(0))
